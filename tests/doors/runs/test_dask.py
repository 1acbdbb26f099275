"""The Dask executor: the conformance suite, each silent trap of Dask avoided, and nobody gets in without the key."""

import os
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import ClassVar

import pytest
from tests.doors.runs.processes import Unloadable, alive, driven_by, hanging_driver, pids, wait_until
from tests.unit.runs.fakes import Seen, batches, campaign, counts, design

from strandline.foundations import InvalidInput
from strandline.runs.executors.dask import DaskCluster, opened
from strandline.testing import executors as suite
from strandline.testing.executors import requests_for
from strandline.testing.models import Cantilever, Counted, Faulty, Slow

distributed = pytest.importorskip("distributed", reason="the extra `dask` is not installed")
pytest.importorskip("cryptography", reason="the extra `dask` is not installed")
psutil = pytest.importorskip("psutil", reason="the extra `dask` is not installed")
BEAM = Cantilever()
KEYS = {"ca-file": "tls_ca_file", "client.cert": "tls_client_cert", "client.key": "tls_client_key"}
REFUSED = r"Timed out|reset by peer|TLS|SSL|closed"
CONFORMANCE = ["answers_each_request_once", "returns_all_conditions_and_sensitivities", "yields_in_order_of_completion"]
CONFORMANCE += ["pulls_when_a_worker_is_free", "unpicklable_exception", "sigkill"]


@pytest.fixture(scope="module")
def cluster():
    """Give a local cluster of two workers, as the executor starts it."""
    with opened("local", None, 2, {}) as cluster:
        cluster.client.wait_for_workers(2)
        yield cluster


@pytest.fixture
def keys(cluster):
    """Give Dask's settings the keys of the cluster."""
    import dask

    given = {f"distributed.comm.tls.{name}": getattr(cluster.client.security, field) for name, field in KEYS.items()}
    with dask.config.set(given):
        yield given


@pytest.fixture
def address(cluster, keys):
    return cluster.address


def test_dask_conforms_at_an_address(address):
    for name in CONFORMANCE:
        (suite.CHECKS | suite.CRASH_CHECKS)[name](DaskCluster(address=address), workers=2)
    suite.TIMEOUT_CHECKS["hang_in_c"](DaskCluster(address=address, timeout=1.0), workers=2)
    suite.WAITING_CHECKS["waits_for_what_follows"](DaskCluster(address=address), workers=2)
    suite.WAITING_CHECKS["asks_beside_a_run"](DaskCluster(address=address), workers=2, pause=0.3)


def test_dask_conforms_on_a_cluster_of_its_own():
    suite.CHECKS["stops_when_closed"](DaskCluster(workers=1), workers=1)
    suite.WAITING_CHECKS["hands_over_before_it_asks_again"](DaskCluster(workers=1), workers=1)


def test_a_closed_campaign_and_a_killed_driver_leave_no_run_at_the_scheduler(address, keys, tmp_path):
    model = Counted(str(tmp_path), Faulty(fault="hang_in_c", above=500.0))
    records = DaskCluster(address=address)(model, requests_for(model, [400.0, 600.0, 600.5]))
    next(records)
    assert wait_until(lambda: len(pids(tmp_path)) >= 2, 30)
    records.close()
    assert wait_until(lambda: not any(map(alive, pids(tmp_path))), 20)
    (tmp_path / "calls").unlink()
    with hanging_driver(tmp_path, f"DaskCluster(address={address!r})", before=f"import dask; dask.config.set({keys})"):
        pass
    assert wait_until(lambda: not any(map(alive, pids(tmp_path))), 60)
    assert len(pids(tmp_path)) == 2


@dataclass(frozen=True)
class KillsItsDaskWorker:
    """Takes the Dask worker down, as the end of a walltime does, in the first `times` runs at 330."""

    folder: str
    times: int
    fingerprint: ClassVar[str] = "test:kills-its-dask-worker"

    def __call__(self, inputs, workdir):
        calls = Path(self.folder) / "calls"
        with calls.open("a") as file:
            file.write(f"{os.getpid()} {inputs['E']}\n")
        if inputs["E"] == 330.0 and calls.read_text().count(" 330.0\n") <= self.times:
            os.kill(os.getppid(), signal.SIGKILL)
            time.sleep(60)
        return BEAM(inputs, workdir)


def test_a_killed_dask_worker_costs_its_own_run_alone(tmp_path):
    """Trap: Dask condemns what waits behind a run whose worker dies (KilledWorker), or repeats the run unasked."""
    model, seen, inputs = KillsItsDaskWorker(str(tmp_path), times=1), Seen(), design(*range(300, 380, 10))
    campaign(tmp_path / "ledger.sqlite", model, inputs, DaskCluster(workers=2), on_record=seen)
    assert Counter(seen.states) == {"ok": 8, "killed": 1}
    assert {record.failure_kind for record, _ in seen} == {None, "worker_died"}
    assert len(pids(tmp_path)) == 9


def test_a_run_whose_worker_vanishes_each_time_is_given_up(tmp_path):
    """Trap: Dask repeats such a run for ever, without an error."""
    model = KillsItsDaskWorker(str(tmp_path), times=9)
    (record,) = campaign(tmp_path / "ledger.sqlite", model, design(330), DaskCluster(workers=1), maximum_attempts=2)
    assert (record.state, record.failure_kind) == ("killed", "worker_died")
    assert len(pids(tmp_path)) == 2


SCHEDULER = """
import sys
from distributed import LocalCluster
if __name__ == "__main__":
    options = {"dashboard_address": "127.0.0.1:0", "memory_limit": 0, "silence_logs": 50}
    cluster = LocalCluster(n_workers=1, threads_per_worker=1, **options)
    print(cluster.scheduler_address, flush=True)
    sys.stdin.read()
"""


def test_a_scheduler_that_dies_costs_the_runs_under_way_alone(tmp_path):
    ends, path, pipe = [], tmp_path / "ledger.sqlite", subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", SCHEDULER], stdout=pipe, stdin=pipe, text=True) as scheduler:
        place = partial(opened, "address", scheduler.stdout.readline().strip(), 1, {}, reach_seconds=2.0)

        def kill(record, progress):
            ends.append(record.state)
            scheduler.kill()

        executor = driven_by(place, silence_borne_seconds=1.0)
        with pytest.raises(InvalidInput, match="cannot be reached any more"):
            campaign(path, Slow(seconds=0.3), design(*range(300, 500, 10)), executor, on_record=kill)
    assert ends[0] == "ok"
    assert ends.count("killed") <= 1
    assert counts(path).total <= 3


@pytest.mark.smoke
def test_a_scheduler_that_is_not_there_is_one_clear_error():
    with (
        pytest.raises(InvalidInput, match=r"tcp://127\.0\.0\.1:9.*dask scheduler"),
        opened("address", "tcp://127.0.0.1:9", 1, {}, reach_seconds=0.3),
    ):
        pytest.fail("there is a scheduler")


def test_a_model_that_no_worker_can_load_is_one_clear_error(address):
    with pytest.raises(InvalidInput, match=r"could not load the model(.|\n)*UnpicklingError"):
        list(DaskCluster(address=address)(Unloadable(), requests_for(BEAM)))


def in_batches(folder, between):
    """Make three batches of four runs by two workers."""

    def choose(records):
        between()
        return design(*(len(records) + 300.0 + 10.0 * k for k in range(4))) if len(records) < 12 else []

    model = Counted(str(folder))
    return batches(folder / "ledger.sqlite", model, [design(*range(400, 440, 10))], choose, DaskCluster(workers=2))


def test_each_worker_is_started_once_for_all_batches_and_none_is_left_behind(tmp_path):
    there = set()

    def look():
        there.update(pids(tmp_path))
        assert all(map(alive, there))

    assert len(in_batches(tmp_path, look)) == 12
    assert len(there) in (1, 2), "one that comes late may find nothing to do"
    assert there == set(pids(tmp_path))
    assert wait_until(lambda: not any(map(alive, there)), 10)


def test_nothing_is_left_behind_after_an_error_between_batches(tmp_path):
    def stop():
        there.update(psutil.Process(pid).ppid() for pid in pids(tmp_path))
        raise KeyboardInterrupt

    there = set()
    with pytest.raises(KeyboardInterrupt):
        in_batches(tmp_path, stop)
    there.update(pids(tmp_path))
    assert wait_until(lambda: not any(map(alive, there)), 10)


def run_of_a_stranger(address, *, timeout=1, **options):
    """Run code on the cluster at `address`, as whoever can reach its port would."""
    with distributed.Client(address, set_as_default=False, timeout=timeout, **options) as client:
        return client.submit(os.getpid).result(timeout=60)


def test_nobody_gets_in_without_the_key(cluster):
    """The workers have ports of their own, by which they could be given runs as well."""
    for address in (cluster.address, next(iter(cluster.client.nthreads()))):
        assert address.startswith("tls://127.0.0.1:")
        with pytest.raises(OSError, match=REFUSED):
            run_of_a_stranger(address.replace("tls://", "tcp://"))
    with pytest.raises(OSError, match=REFUSED):
        run_of_a_stranger(cluster.address, security=distributed.Security.temporary())
    assert run_of_a_stranger(cluster.address, timeout=60, security=cluster.client.security) != os.getpid()
    with (
        pytest.raises(InvalidInput, match=r"tls://127\.0\.0\.1.*distributed\.comm\.tls"),
        opened("address", cluster.address, 1, {}, reach_seconds=1.0),
    ):
        pytest.fail("let in")


def test_a_local_cluster_listens_on_loopback_alone_and_shows_its_key_on_no_command_line(cluster):
    children = psutil.Process().children(recursive=True)
    connections = [each for one in (psutil.Process(), *children) for each in one.net_connections("inet")]
    listening = [each.laddr.ip for each in connections if each.status == psutil.CONN_LISTEN]
    assert len(listening) >= 3
    assert set(listening) <= {"127.0.0.1", "::1"}
    secret = cluster.client.security.tls_worker_key.splitlines()[1]
    assert not any(secret in " ".join(child.cmdline()) for child in children)
