"""Runs as jobs of real SLURM arrays: the conformance suite, and each way in which jobs, nodes and drivers go."""

import os
import pickle
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from tests.doors.runs.processes import wait_until
from tests.unit.runs.fakes import attempts, calls, counts, design, states

from strandline.foundations import InvalidInput
from strandline.runs import Counts, Ledger, run_campaign
from strandline.runs.executors.slurm_array import Detached, SlurmArray
from strandline.testing.executors import CHECKS, CRASH_CHECKS, TIMEOUT_CHECKS, requests_for
from strandline.testing.models import Cantilever, Counted, Faulty, Slow

TASK = str(Path(__file__).with_name("pickled_task.py"))
CONFORMANCE = ["pulls_when_a_worker_is_free", "returns_all_conditions_and_sensitivities"]
CONFORMANCE += ["stops_when_closed", "sigkill"]


def array(folder, model, **options):
    """Return an executor whose jobs take `model` from a pickle in `folder`."""
    file = folder / "model.pickle"
    if not file.exists():
        file.write_bytes(pickle.dumps(model))
    return SlurmArray(folder / "slurm", (sys.executable, TASK, str(file)), **{"poll": 0.2, **options})


def pickled(folder, **options):
    """Return an executor that pickles whatever model it is given."""
    return lambda model, requests: array(folder, model, **options)(model, requests)


def test_slurm_array_conforms(slurm, tmp_path):
    for name in CONFORMANCE:
        (tmp_path / name).mkdir()
        (CHECKS | CRASH_CHECKS)[name](pickled(tmp_path / name, max_jobs=2), workers=2)
    TIMEOUT_CHECKS["hanging_child"](pickled(tmp_path, timeout=1.0), workers=6)


def ledger_of(folder):
    return folder / "ledger.sqlite"


def campaign(folder, model, number, on_record=None, **options):
    with Ledger.open(ledger_of(folder), model=model) as ledger:
        executor, inputs = array(folder, model, **options), design(*(300.0 + 5.0 * k for k in range(number)))
        return run_campaign(model, inputs, ledger=ledger, executor=executor, on_record=on_record)


def detached(folder, model, number, **options):
    with pytest.raises(Detached):
        campaign(folder, model, number, detach=True, **options)


def collected(folder, model, number, tries=1):
    """Collect the runs; require that each was made once, and started so many times."""
    assert states(campaign(folder, model, number)) == ["ok"] * number
    assert sorted(calls(folder).values()) == [1] * number
    assert attempts(ledger_of(folder)) == [tries] * number


def job_of(folder):
    (job,) = (folder / "slurm").glob("*/job")
    return job


def test_a_campaign_in_arrays_that_are_cut_to_what_slurm_allows(slurm, tmp_path, monkeypatch):
    monkeypatch.setattr("strandline.runs.executors.slurm_batch.largest_array", lambda: 4)
    campaign(tmp_path, Counted(str(tmp_path)), 10)
    assert sorted(calls(tmp_path).values()) == [1] * 10
    assert counts(ledger_of(tmp_path)) == Counts(ok=10)
    assert not list((tmp_path / "slurm").iterdir()), "what the ledger has is removed"


DRIVER = """
import sys
from pathlib import Path
from strandline.testing.models import Counted, Slow
from tests.doors.slurm.test_slurm_array import campaign
campaign(Path(sys.argv[1]), Counted(sys.argv[1], Slow(seconds=1.0)), 12)
"""


def test_a_killed_driver_repeats_nothing_and_loses_nothing(slurm, tmp_path):
    model, ledger = Counted(str(tmp_path), Slow(seconds=1.0)), ledger_of(tmp_path)
    options = {"env": {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}, "stderr": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", DRIVER, str(tmp_path)], **options) as driver:
        assert wait_until(lambda: ledger.exists() and counts(ledger).ok >= 2, 60)
        driver.kill()
        driver.wait(30)
    before = counts(ledger)
    assert before.total == 12
    assert before.open == 12 - before.ok > 0, "the runs of the array go on; none of them is an interrupted one"
    collected(tmp_path, model, 12)


def test_a_driver_that_leaves_many_times_gives_no_run_up(slurm, tmp_path):
    """A start is an attempt, the coming of a driver is not: else a long array would be given up by restarts.

    The last driver left before it could note its submission, which is found.
    """
    model = Counted(str(tmp_path), Slow(seconds=3.0))
    for _ in range(4):
        detached(tmp_path, model, 2)
    job_of(tmp_path).unlink()
    collected(tmp_path, model, 2)


def running(slurm):
    """Return number in the array, job and node of each job that runs."""
    rows = slurm.command("squeue", "--noheader", "--array", "--states=RUNNING", "--format=%K|%i|%N").split()
    return sorted((int(number), job, node) for number, job, node in (row.split("|") for row in rows))


def disturbed(folder, model, number, disturb, **options):
    """Run a campaign that `disturb` meets after its first record; return the records, and how each attempt ended."""
    ends = []

    def note(record, progress):
        ends.append((record.state, record.failure_kind))
        if len(ends) == 1:
            disturb()

    done = campaign(folder, model, number, on_record=note, **options)
    return done, Counter(ends)


def begun_lately(slurm):
    """Return a job that has begun after all of the first ones, which are as many as there are processors."""
    assert wait_until(lambda: any(number > 5 for number, *_ in running(slurm)), 20)
    return running(slurm)[-1]


def test_runs_on_a_node_that_fails_are_made_again(slurm, tmp_path):
    def fail():
        node = begun_lately(slurm)[2]
        slurm.command("scontrol", "update", f"nodename={node}", "state=down", "reason=test")

    done, ends = disturbed(tmp_path, Counted(str(tmp_path), Slow(seconds=3.0)), 8, fail)
    assert states(done) == ["ok"] * 8
    assert ends[("ok", None)] == 8
    assert 1 <= ends[("killed", "node_failed")] <= 2
    assert set(ends) == {("ok", None), ("killed", "node_failed")}


def test_a_controller_that_is_killed_and_started_again_costs_nothing(slurm, tmp_path):
    model = Counted(str(tmp_path), Slow(seconds=2.0))

    def restart():
        slurm.kill_controller(saved_after=job_of(tmp_path).stat().st_mtime)
        ended = calls(tmp_path, "ends").total()
        wait_until(lambda: calls(tmp_path, "ends").total() > ended, 2.0)
        slurm.start_controller()
        assert calls(tmp_path).total() < 15, "all runs had started before the controller died"

    done, ends = disturbed(tmp_path, model, 15, restart)
    assert states(done) == ["ok"] * 15
    assert set(ends) <= {("ok", None), ("killed", "node_failed")}, "a job may be lost on its way to its node"
    assert sorted(calls(tmp_path).values()) == [1] * 15


def test_a_run_that_is_told_of_the_end_of_its_walltime_is_a_timeout(slurm, tmp_path):
    """SLURM sends SIGUSR1 to the job 45 s before the end; here the test does, for a minute is the least walltime."""
    model = Counted(str(tmp_path), Faulty(fault="hang", above=302.0))

    def announce():
        assert wait_until(lambda: calls(tmp_path).total() == 3 and len(running(slurm)) == 2, 20)
        for _, job, _ in running(slurm):
            slurm.command("scancel", "--batch", "--signal=USR1", job)

    done, _ = disturbed(tmp_path, model, 3, announce, walltime="00:05:00")
    assert [(record.state, record.failure_kind) for record in done] == [("ok", None), *[("timeout", "walltime")] * 2]
    assert "waiting for nothing" in done[1].message
    assert sorted(calls(tmp_path).values()) == [1] * 3, "not tried again: it would take as long"


def test_what_slurm_refuses_is_one_clear_error_and_costs_no_attempt(slurm, tmp_path):
    model = Counted(str(tmp_path))
    with pytest.raises(InvalidInput, match=r"sbatch failed.*invalid partition.*sinfo"):
        campaign(tmp_path, model, 3, partition="nowhere")
    assert not list((tmp_path / "slurm").iterdir())
    collected(tmp_path, model, 3)


def test_a_model_that_has_changed_stops_the_array(slurm, tmp_path):
    array(tmp_path, Cantilever(length=2.0))
    with pytest.raises(InvalidInput, match="model has changed since the runs were submitted"):
        campaign(tmp_path, Cantilever(), 3)
    assert wait_until(lambda: not slurm.command("squeue", "--noheader"), 20)


def test_a_damaged_result_is_made_again(slurm, tmp_path):
    model = Counted(str(tmp_path))
    detached(tmp_path, model, 2)
    assert wait_until(lambda: len(list((tmp_path / "slurm").glob("*/results/*.run"))) == 2, 30)
    (path,) = (tmp_path / "slurm").glob("*/results/1.run")
    path.write_bytes(path.read_bytes()[:-100] + bytes(100))
    assert states(campaign(tmp_path, model, 2)) == ["ok"] * 2
    assert sorted(calls(tmp_path).values()) == [1, 2]


@pytest.mark.smoke
def test_a_job_that_comes_after_its_batch_was_given_up_does_nothing(tmp_path):
    command = [sys.executable, TASK, str(tmp_path / "model.pickle"), str(tmp_path / "gone"), "0"]
    assert subprocess.run(command, check=False).returncode == 0


@pytest.mark.smoke
def test_without_slurm_there_is_one_clear_error(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InvalidInput, match=r"no command .*Run it where jobs are submitted"):
        list(array(tmp_path, Cantilever())(Cantilever(), requests_for(Cantilever())))


def test_a_batch_that_was_never_submitted_is_submitted(slurm, tmp_path):
    model = Counted(str(tmp_path))
    detached(tmp_path, model, 2, extra=("--hold",))
    slurm.quiet()
    job_of(tmp_path).unlink()
    for path in (tmp_path / "slurm").iterdir():
        path.rename(path.with_name("strandline-never"))
    collected(tmp_path, model, 2, tries=2)


def test_a_cancelled_job_is_made_again(slurm, tmp_path):
    model = Counted(str(tmp_path), Slow(seconds=2.0))
    done, ends = disturbed(tmp_path, model, 10, lambda: slurm.command("scancel", begun_lately(slurm)[1]))
    assert states(done) == ["ok"] * 10
    assert ends == {("ok", None): 10, ("killed", "cancelled"): 1}
    assert calls(tmp_path).total() <= 11
