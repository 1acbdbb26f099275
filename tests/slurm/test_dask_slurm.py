"""A Dask cluster in jobs of a real SLURM: its silent traps, each of which would hang a campaign."""

import time
from collections import Counter

import pytest

from strandline.errors import InvalidInput
from strandline.models.protocol import fingerprint
from strandline.runs import Ledger, run_campaign
from strandline.runs.executors import dask as dask_executor
from strandline.runs.executors.dask import DaskCluster
from strandline.testing.executors import requests_for
from strandline.testing.models import Cantilever, Counted, Slow

pytest.importorskip("dask_jobqueue", reason="the extra `dask` is not installed")
JOBS = {"cores": 1, "memory": "400MB", "walltime": "00:30:00", "interface": "lo"}


@pytest.fixture(autouse=True)
def in_its_folder(slurm, tmp_path, monkeypatch):
    """Let the logs of the jobs lie in the test's folder."""
    monkeypatch.chdir(tmp_path)


def campaign(folder, model, number, on_record, executor):
    inputs = [{"E": 300.0 + 5.0 * k, "load": 1e-5} for k in range(number)]
    with Ledger.open(folder / "ledger.sqlite", model=fingerprint(model)) as ledger:
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
    monkeypatch.setattr(dask_executor, "SPARE_SECONDS", 0.0)
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
