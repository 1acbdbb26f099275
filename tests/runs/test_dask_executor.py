"""The Dask executor: the conformance suite, and each silent trap of Dask reproduced and avoided."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import pytest

from strandline.errors import InvalidInput
from strandline.runs import Counts, Ledger, run_campaign
from strandline.runs.executors import dask_cluster, dask_driver
from strandline.runs.executors.dask import DaskCluster
from strandline.testing.executors import CHECKS, CRASH_CHECKS, TIMEOUT_CHECKS, requests_for
from strandline.testing.models import Cantilever, Counted, Faulty, Slow

pytest.importorskip("distributed", reason="the extra `dask` is not installed")
JOBS = {"cores": 1, "memory": "500MB", "walltime": "01:00:00"}


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory):
    """Start a scheduler with two workers, each a process of its own, and return its address."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0", memory_limit=0, silence_logs=50
    ) as cluster:
        yield cluster.scheduler_address


@pytest.mark.parametrize("check", (CHECKS | CRASH_CHECKS).values(), ids=(CHECKS | CRASH_CHECKS).keys())
def test_dask_conforms_at_an_address(check, scheduler):
    check(DaskCluster(address=scheduler), workers=2)


@pytest.mark.parametrize("check", TIMEOUT_CHECKS.values(), ids=TIMEOUT_CHECKS.keys())
def test_dask_stops_hanging_runs(check, scheduler):
    check(DaskCluster(address=scheduler, timeout=1.5), workers=2)


OWN = ["answers_each_request_once", "pulls_when_a_worker_is_free"]


@pytest.mark.parametrize("name", ["stops_when_closed", *(pytest.param(name, marks=pytest.mark.long) for name in OWN)])
def test_dask_conforms_on_a_cluster_of_its_own(name):
    CHECKS[name](DaskCluster(workers=2), workers=2)


def test_no_request_starts_no_cluster(monkeypatch):
    monkeypatch.setattr(dask_cluster, "opened", lambda *_: pytest.fail("a cluster was started"))
    assert list(DaskCluster(cluster="slurm", workers=2, jobs=JOBS)(Cantilever(), [])) == []


def test_a_closed_campaign_leaves_no_process_at_the_scheduler(scheduler, tmp_path):
    model = Counted(str(tmp_path), Faulty(fault="hang_in_c", above=500.0))
    records = DaskCluster(address=scheduler)(model, requests_for(model, [400.0, 600.0, 600.5]))
    next(records)
    assert wait_until(lambda: len(pids(tmp_path)) >= 2, 30)
    records.close()
    assert wait_until(lambda: not any(alive(pid) for pid in pids(tmp_path)), 20)


DRIVER = """
import sys
from strandline.runs.executors.dask import DaskCluster
from strandline.testing.executors import requests_for
from strandline.testing.models import Counted, Faulty
if __name__ == "__main__":
    model = Counted(sys.argv[2], Faulty(fault="hang_in_c", above=0.0))
    list(DaskCluster(address=sys.argv[1])(model, requests_for(model)))
"""


def test_a_killed_driver_leaves_no_run_at_the_scheduler(scheduler, tmp_path):
    with subprocess.Popen([sys.executable, "-c", DRIVER, scheduler, str(tmp_path)]) as driver:
        try:
            assert wait_until(lambda: len(pids(tmp_path)) == 2, 60)
        finally:
            driver.kill()
    assert wait_until(lambda: not any(alive(pid) for pid in pids(tmp_path)), 60)
    assert len(pids(tmp_path)) == 2


@dataclass(frozen=True)
class StaysTheFirstTime:
    """Leaves the number of its Dask worker and stays, the first time that it is called at `stays`."""

    folder: str
    stays: float
    fingerprint: ClassVar[str] = "test:stays-the-first-time"

    @property
    def mark(self):
        return Path(self.folder) / "worker"

    def __call__(self, inputs, workdir):
        if inputs["E"] == self.stays and not self.mark.exists():
            (workdir / "worker").write_text(str(os.getppid()))
            (workdir / "worker").rename(self.mark)
            time.sleep(60)
        return Cantilever()(inputs, workdir)


def test_a_killed_dask_worker_costs_its_own_run_alone(tmp_path):
    """Trap: Dask condemns what waits behind a run whose worker dies (KilledWorker), or repeats the run unasked."""
    model, seen = StaysTheFirstTime(str(tmp_path), stays=330.0), []

    def shoot(record, progress):
        seen.append((record.state, record.failure_kind))
        if len(seen) == 5:  # runs are handed out in their order: it has been, and stays
            assert wait_until(model.mark.exists, 20)
            os.kill(int(model.mark.read_text()), signal.SIGKILL)

    calls = Counted(str(tmp_path), model)
    inputs = [{"E": 300.0 + 10 * k, "load": 1e-5} for k in range(8)]
    with Ledger.open(tmp_path / "ledger.sqlite", model=calls) as ledger:
        done = run_campaign(calls, inputs, ledger=ledger, executor=DaskCluster(workers=2), on_record=shoot)
        assert ledger.counts() == Counts(ok=8)
    assert all(record.ok for record in done)
    assert seen.count(("killed", "worker_died")) == 1
    assert len(seen) == 9
    assert len(pids(tmp_path)) == 9


@dataclass(frozen=True)
class KillsItsDaskWorker:
    """Takes the Dask worker of each run down, as the end of a walltime does."""

    folder: str
    fingerprint: ClassVar[str] = "test:kills-its-dask-worker"

    def __call__(self, inputs, workdir):
        with (Path(self.folder) / "calls").open("a") as calls:
            calls.write(f"{os.getpid()}\n")
        os.kill(os.getppid(), signal.SIGKILL)
        time.sleep(60)


def test_a_run_whose_worker_vanishes_each_time_is_given_up(tmp_path):
    """Trap: Dask repeats such a run for ever, without an error."""
    model = KillsItsDaskWorker(str(tmp_path))
    with Ledger.open(tmp_path / "ledger.sqlite", model=model) as ledger:
        executor = DaskCluster(workers=1)
        (record,) = run_campaign(model, [{"E": 300.0}], ledger=ledger, executor=executor, maximum_attempts=2)
    assert (record.state, record.failure_kind) == ("killed", "worker_died")
    assert len(pids(tmp_path)) == 2


def test_a_worker_that_comes_back_too_late_is_replaced(tmp_path, monkeypatch):
    """Trap: Dask closes the place of such a worker, and no other takes it."""
    late = []

    async def leave_alone(nanny, exitcode):
        late.append(exitcode)

    monkeypatch.setattr("distributed.nanny.Nanny._on_worker_exit", leave_alone)
    monkeypatch.setattr(dask_cluster, "LOST_PROCESS_SECONDS", 1)
    model = KillsItsDaskWorker(str(tmp_path))
    with Ledger.open(tmp_path / "ledger.sqlite", model=model) as ledger:
        executor = DaskCluster(workers=1)
        (record,) = run_campaign(model, [{"E": 300.0}], ledger=ledger, executor=executor, maximum_attempts=2)
    assert late
    assert (record.state, record.failure_kind) == ("killed", "worker_died")
    assert len(pids(tmp_path)) == 2


def test_a_closure_is_refused_before_a_cluster_is_started(monkeypatch):
    """Trap: a closure cannot be pickled; Dask says so late, in the middle of a traceback of its own."""
    monkeypatch.setattr(dask_cluster, "opened", lambda *_: pytest.fail("a cluster was started"))
    with pytest.raises(InvalidInput, match="cannot be sent to worker processes"):
        DaskCluster()(lambda inputs, workdir: None, requests_for(Cantilever()))


@pytest.mark.parametrize("walltime", ["00:10:00", "10:00", "0-00:10"])
def test_a_timeout_above_the_walltime_is_refused(walltime):
    """Trap: a run that outlives its job is killed and submitted again, for ever and without an error."""
    with pytest.raises(InvalidInput, match=r"at most 540 s"):
        DaskCluster(cluster="slurm", timeout=541.0, jobs=JOBS | {"walltime": walltime})
    DaskCluster(cluster="slurm", timeout=540.0, jobs=JOBS | {"walltime": walltime})


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"cluster": "moab"}, "local, slurm, pbs"),
        ({"cluster": "local", "address": "tcp://here:1"}, "one of the two"),
        ({"workers": 2, "maximum": 3}, "workers alone"),
        ({"maximum": 3}, "whose jobs come and go"),
        ({"address": "tcp://here:1", "workers": 3}, "the workers that the scheduler has"),
        ({"cluster": "slurm", "minimum": 3, "maximum": 2, "jobs": JOBS}, "a maximum that is at least as large"),
        ({"cluster": "slurm", "minimum": 3, "jobs": JOBS}, "a maximum that is at least as large"),
        ({"jobs": JOBS}, "this cluster has no jobs"),
        ({"cluster": "slurm", "jobs": {"cores": 1, "memory": "1GB"}}, "Add walltime"),
        ({"cluster": "pbs", "jobs": JOBS | {"project": "x"}}, "Remove project"),
        ({"cluster": "slurm", "jobs": JOBS | {"walltime": "60"}}, "in quotes"),
        ({"workers": 0}, "at least 1"),
        ({"timeout": 0.0}, "seconds above 0"),
    ],
)
def test_senseless_options_are_refused(options, said):
    with pytest.raises(InvalidInput, match=said):
        DaskCluster(**options)


def test_a_scheduler_that_is_not_there_is_one_clear_error(monkeypatch):
    monkeypatch.setattr(dask_cluster, "REACH_SECONDS", 0.5)
    with pytest.raises(InvalidInput, match=r"tcp://127\.0\.0\.1:9.*dask scheduler"):
        list(DaskCluster(address="tcp://127.0.0.1:9")(Cantilever(), requests_for(Cantilever())))


SCHEDULER = """
import sys
from distributed import LocalCluster
if __name__ == "__main__":
    options = {"dashboard_address": "127.0.0.1:0", "memory_limit": 0, "silence_logs": 50}
    cluster = LocalCluster(n_workers=1, threads_per_worker=1, **options)
    print(cluster.scheduler_address, flush=True)
    sys.stdin.read()
"""


def test_a_scheduler_that_dies_costs_the_runs_under_way_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(dask_driver, "SILENCE_BORNE_SECONDS", 2.0)
    model, ends = Slow(seconds=0.5), []
    command = [sys.executable, "-c", SCHEDULER]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stdin=subprocess.PIPE, text=True) as scheduler:
        executor = DaskCluster(address=scheduler.stdout.readline().strip())

        def kill(record, progress):
            ends.append(record.state)
            scheduler.kill()

        inputs = [{"E": 300.0 + 10 * k, "load": 1e-5} for k in range(20)]
        with Ledger.open(tmp_path / "ledger.sqlite", model=model) as ledger:
            with pytest.raises(InvalidInput, match="cannot be reached any more"):
                run_campaign(model, inputs, ledger=ledger, executor=executor, on_record=kill)
            assert ends[0] == "ok"
            assert ends.count("killed") <= 1
            assert ledger.counts().total <= 3


def test_a_missing_extra_names_its_install_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InvalidInput, match=r'pip install "strandline\[dask\]"'):
        DaskCluster()(Cantilever(), requests_for(Cantilever()))


class Unloadable:
    fingerprint = "test:unloadable"

    def __reduce__(self):
        return int, ("no number",)

    def __call__(self, inputs, workdir):
        raise AssertionError


def test_a_model_that_no_worker_can_load_is_one_clear_error(scheduler):
    with pytest.raises(InvalidInput, match=r"could not load the model.*no number"):
        list(DaskCluster(address=scheduler)(Unloadable(), requests_for(Cantilever())))


def test_an_unguarded_script_gets_the_remedy(tmp_path):
    script = tmp_path / "script.py"
    text = """
        from strandline.runs.executors.dask import DaskCluster
        from strandline.testing.executors import requests_for
        from strandline.testing.models import Cantilever
        print(len(list(DaskCluster(workers=1)(Cantilever(), requests_for(Cantilever())))))
        """
    script.write_text(textwrap.dedent(text))
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode != 0
    assert "under `if __name__ == '__main__':`" in done.stderr


def pids(folder: Path) -> list[int]:
    calls = folder / "calls"
    return [int(line.split()[0]) for line in calls.read_text().splitlines()] if calls.exists() else []


def status(pid: int) -> list[str]:
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()


def alive(pid: int) -> bool:
    try:
        return status(pid)[0] != "Z"
    except OSError:
        return False


def parent(pid: int) -> int:
    return int(status(pid)[1])


def wait_until(condition, seconds):
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.02)
    return condition()
