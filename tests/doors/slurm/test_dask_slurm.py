"""A Dask cluster in jobs of a real SLURM: its silent traps, each of which would hang a campaign."""

from collections import Counter
from functools import partial

import pytest
from tests.doors.runs.processes import driven_by, wait_until
from tests.unit.runs.fakes import campaign, design, states

from strandline.foundations import InvalidInput
from strandline.runs.executors.dask import DaskCluster, opened
from strandline.testing.executors import requests_for
from strandline.testing.models import Cantilever, Slow

pytest.importorskip("dask_jobqueue", reason="the extra `dask` is not installed")
JOBS = {"cores": 1, "memory": "400MB", "walltime": "00:30:00", "interface": "lo"}
IN_JOBS = partial(DaskCluster, cluster="slurm", workers=1, jobs=JOBS)


@pytest.fixture
def path(slurm, tmp_path, monkeypatch):
    """Give a place for a ledger; the logs of the jobs, and the keys, lie beside it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    return tmp_path / "ledger.sqlite"


def some(number):
    return design(*(300.0 + 5.0 * k for k in range(number)))


def job_ids(slurm):
    return slurm.command("squeue", "--noheader", "--states=RUNNING", "--format=%i").split()


def test_a_cancelled_worker_is_replaced(slurm, path):
    """Trap: with `scale()` alone the worker is never replaced, and the campaign hangs."""
    ends, cancelled = [], []

    def cancel(record, progress):
        ends.append((record.state, record.failure_kind))
        if not cancelled:
            cancelled.extend(job_ids(slurm))
            slurm.command("scancel", *cancelled)

    done = campaign(path, Slow(seconds=1.0), some(4), IN_JOBS(), on_record=cancel)
    assert len(cancelled) == 1
    assert states(done) == ["ok"] * 4
    assert Counter(ends) == {("ok", None): 4, ("killed", "worker_died"): 1}
    assert wait_until(lambda: not slurm.command("squeue", "--noheader"), 20), "a job is left behind"


def test_a_worker_goes_before_its_walltime_cuts_a_run(slurm, path):
    """Trap: a run that its job does not outlive is killed and submitted again, and again.

    The jobs live for 36 s, of which 30 s are to spare and a run may take 3 s.
    """
    ended, jobs = [], set()

    def note(record, progress):
        ended.append(record.state)
        jobs.update(job_ids(slurm))

    executor = driven_by(partial(opened, "slurm", None, 1, JOBS), timeout=3.0, life=36.0)
    campaign(path, Slow(seconds=1.0), some(6), executor, on_record=note)
    assert ended == ["ok"] * 6
    assert len(jobs) >= 2, "no job was replaced"


def test_jobs_that_slurm_refuses_are_one_clear_error(slurm, path):
    """Trap: Dask waits for ever for a worker whose job was never taken."""
    executor = IN_JOBS(jobs=JOBS | {"queue": "nowhere"})
    with pytest.raises(InvalidInput, match=r"takes no job.*Invalid partition.*executor\.dask\.jobs"):
        list(executor(Cantilever(), requests_for(Cantilever())))
    assert not job_ids(slurm)
