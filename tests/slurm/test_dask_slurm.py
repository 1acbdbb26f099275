"""A Dask cluster in jobs of a real SLURM: its silent traps, each of which would hang a campaign."""

import time
from collections import Counter

import pytest

from strandline.errors import InvalidInput
from strandline.runs import Ledger, run_batches, run_campaign
from strandline.runs.executors import dask as dask_executor
from strandline.runs.executors import dask_driver
from strandline.runs.executors.dask import DaskCluster
from strandline.runs.executors.dask_cluster import opened
from strandline.testing.executors import requests_for
from strandline.testing.models import Cantilever, Counted, Slow

pytest.importorskip("dask_jobqueue", reason="the extra `dask` is not installed")
JOBS = {"cores": 1, "memory": "400MB", "walltime": "00:30:00", "interface": "lo"}
REFUSED = "Timed out|reset by peer|TLS|SSL|closed"


@pytest.fixture(autouse=True)
def in_its_folder(slurm, tmp_path, monkeypatch):
    """Let the logs of the jobs, and the keys, lie in the test's folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))


def campaign(folder, model, number, on_record, executor):
    inputs = [{"E": 300.0 + 5.0 * k, "load": 1e-5} for k in range(number)]
    with Ledger.open(folder / "ledger.sqlite", model=model) as ledger:
        return run_campaign(model, inputs, ledger=ledger, executor=executor, on_record=on_record)


def job_ids(slurm):
    return slurm.command("squeue", "--noheader", "--states=RUNNING", "--format=%i").split()


def test_a_cancelled_worker_is_replaced(slurm, tmp_path):
    """Trap: with `scale()` alone the worker is never replaced, and the campaign hangs."""
    ends, cancelled = [], []
    executor = DaskCluster(cluster="slurm", workers=1, jobs=JOBS)

    def cancel(record, progress):
        ends.append((record.state, record.failure_kind))
        if not cancelled:
            cancelled.extend(job_ids(slurm))
            slurm.command("scancel", *cancelled)

    done = campaign(tmp_path, Counted(str(tmp_path), Slow(seconds=1.0)), 4, cancel, executor)
    assert len(cancelled) == 1
    assert all(record.ok for record in done)
    assert Counter(ends) == {("ok", None): 4, ("killed", "worker_died"): 1}


def test_a_worker_goes_before_its_walltime_cuts_a_run(slurm, tmp_path, monkeypatch):
    """Trap: a run that its job does not outlive is killed and submitted again, and again."""
    monkeypatch.setattr(dask_executor, "walltime_seconds", lambda text: 6.0)
    monkeypatch.setattr(dask_driver, "SPARE_SECONDS", 0.0)
    states, jobs = [], set()

    def note(record, progress):
        states.append(record.state)
        jobs.update(job_ids(slurm))

    executor = DaskCluster(cluster="slurm", workers=1, timeout=3.0, jobs=JOBS)
    campaign(tmp_path, Slow(seconds=1.0), 6, note, executor)
    assert states == ["ok"] * 6
    assert len(jobs) >= 2, "no job was replaced"


def test_jobs_that_slurm_refuses_are_one_clear_error(slurm, tmp_path):
    """Trap: Dask waits for ever for a worker whose job was never taken."""
    executor = DaskCluster(cluster="slurm", workers=2, jobs=JOBS | {"queue": "nowhere"})
    began = time.monotonic()
    with pytest.raises(InvalidInput, match=r"takes no job.*Invalid partition.*executor\.dask\.jobs"):
        list(executor(Cantilever(), requests_for(Cantilever())))
    assert time.monotonic() - began < 60.0
    assert not job_ids(slurm)


def test_no_job_is_left_behind(slurm):
    records = DaskCluster(cluster="slurm", workers=2, jobs=JOBS)(Slow(seconds=0.1), requests_for(Slow()))
    assert next(records).ok
    records.close()
    began = time.monotonic()
    while slurm.command("squeue", "--noheader") and time.monotonic() < began + 20.0:
        time.sleep(0.2)
    assert not slurm.command("squeue", "--noheader")


def test_a_queue_full_of_other_jobs_is_waited_for(slurm, tmp_path):
    for _ in range(6):
        slurm.command("sbatch", "--output=/dev/null", "--wrap=sleep 6")
    done = campaign(tmp_path, Cantilever(), 4, None, DaskCluster(cluster="slurm", workers=1, jobs=JOBS))
    assert all(record.ok for record in done)


def test_jobs_are_kept_from_batch_to_batch(slurm, tmp_path):
    """A job that is cancelled while the driver chooses is replaced, and no run is lost by it."""
    jobs = []

    def choose(records):
        jobs.append(job_ids(slurm))
        if len(jobs) == 2:
            slurm.command("scancel", *jobs[-1])
            time.sleep(2.0)
        return [] if len(jobs) == 3 else batch(300.0 + 100.0 * len(jobs))

    def batch(stiffness):
        return [{"E": stiffness + 5.0 * k, "load": 1e-5} for k in range(4)]

    model, executor = Cantilever(), DaskCluster(cluster="slurm", workers=1, jobs=JOBS)
    with Ledger.open(tmp_path / "ledger.sqlite", model=model) as ledger:
        records = run_batches(model, [batch(300.0)], choose, ledger=ledger, executor=executor)
        assert {ledger.attempts(record.key) for record in ledger} == {1}
    assert len(records) == 12
    assert all(record.ok for record in records)
    first, second, third = jobs
    assert len(first) == 1
    assert second == first
    assert len(third) == 1
    assert third != second
    assert not slurm.command("squeue", "--noheader", "--states=RUNNING,PENDING")


def test_a_stranger_is_refused_and_sees_no_key(slurm, tmp_path):
    import dask
    import psutil
    from distributed import Client

    with (
        dask.config.set({"jobqueue.slurm.shared-temp-directory": str(tmp_path / "keys")}),
        opened("slurm", None, 1, JOBS) as cluster,
    ):
        cluster.client.wait_for_workers(1, timeout=60)
        assert cluster.address.startswith("tls://127.0.0.1:")
        for address in (cluster.address, *cluster.client.nthreads()):
            with pytest.raises(OSError, match=REFUSED):
                Client(address.replace("tls://", "tcp://"), timeout=3, set_as_default=False)
        key = next((tmp_path / "keys").glob("*/key.pem"))
        assert key.stat().st_mode & 0o777 == 0o600
        lines = [" ".join(process.info["cmdline"] or ()) for process in psutil.process_iter(["cmdline"])]
        assert any(str(key) in line for line in lines)
        assert not any(key.read_text().splitlines()[1] in line for line in lines)
        assert cluster.maker.scheduler.http_server.address == "127.0.0.1"
    assert list((tmp_path / "keys").iterdir()) == []
