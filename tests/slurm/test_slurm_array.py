"""Runs as jobs of real SLURM arrays: the conformance suite, and each way in which jobs, nodes and drivers go."""

import os
import pickle
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest

from strandline.errors import InvalidInput
from strandline.runs import Counts, Ledger, run_campaign
from strandline.runs.executors.slurm_array import Detached, SlurmArray
from strandline.testing.executors import CHECKS, CRASH_CHECKS, TIMEOUT_CHECKS, requests_for
from strandline.testing.models import Cantilever, Counted, Faulty, Slow

TASK = str(Path(__file__).with_name("pickled_task.py"))


def array(folder: Path, model, **options) -> SlurmArray:
    """Return an executor whose jobs take `model` from a pickle in `folder`."""
    file = folder / "model.pickle"
    if not file.exists():
        file.write_bytes(pickle.dumps(model))
    return SlurmArray(folder / "slurm", (sys.executable, TASK, str(file)), **{"poll": 0.3, **options})


def pickled(folder: Path, **options):
    """Return an executor that pickles whatever model it is given."""

    def execute(model, requests):
        return array(folder, model, **options)(model, requests)

    return execute


REPEATED = {"answers_each_request_once", "returns_the_models_result", "exception", "declared_failure", "system_exit"}
REPEATED |= {"nothing_returned", "exit", "segfault", "hang_in_c"}
"""Checks whose way through a job another one takes too: an exception is one that cannot be pickled, a death another."""


def quick_first(checks):
    """Return the checks as parameters, the repeated ones left to `make test-all`."""
    long = {name: [pytest.mark.long] for name in REPEATED}
    return [pytest.param(check, id=name, marks=long.get(name, [])) for name, check in checks.items()]


@pytest.mark.parametrize("check", quick_first(CHECKS | CRASH_CHECKS))
def test_slurm_array_conforms(check, slurm, tmp_path):
    check(pickled(tmp_path, max_jobs=2), workers=2)


@pytest.mark.parametrize("check", quick_first(TIMEOUT_CHECKS))
def test_slurm_array_stops_hanging_runs(check, slurm, tmp_path):
    check(pickled(tmp_path, timeout=1.5), workers=6)


def design(number):
    return [{"E": 300.0 + 5.0 * k, "load": 1e-5} for k in range(number)]


def campaign(folder, model, number, on_record=None, **options):
    with Ledger.open(folder / "ledger.sqlite", model=model) as ledger:
        executor = array(folder, model, **options)
        return run_campaign(model, design(number), ledger=ledger, executor=executor, on_record=on_record)


def counts(folder):
    with Ledger.open(folder / "ledger.sqlite", model=None, read_only=True) as ledger:
        return ledger.counts()


def calls(folder):
    """Return how often each run was begun."""
    file = folder / "calls"
    lines = file.read_text().splitlines() if file.exists() else []
    return Counter(line.partition(" ")[2] for line in lines)


def wait_until(condition, seconds):
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.05)
    return condition()


def test_a_campaign_end_to_end(slurm, tmp_path):
    done = campaign(tmp_path, Counted(str(tmp_path)), 30)
    for record, inputs in zip(done, design(30), strict=True):
        assert record.interface.points.tobytes() == Cantilever()(inputs, tmp_path).interface.points.tobytes()
    assert set(calls(tmp_path).values()) == {1}
    assert not list((tmp_path / "slurm").iterdir()), "what the ledger has is removed"


DRIVER = """
import sys
from pathlib import Path
from strandline.models.protocol import fingerprint
from strandline.runs import Ledger, run_campaign
from strandline.runs.executors.slurm_array import SlurmArray
from strandline.testing.models import Counted, Slow
folder, task, number = sys.argv[1], sys.argv[2], int(sys.argv[3])
model = Counted(folder, Slow(seconds=1.0))
inputs = [{"E": 300.0 + 5.0 * k, "load": 1e-5} for k in range(number)]
executor = SlurmArray(Path(folder) / "slurm", (sys.executable, task, folder + "/model.pickle"), poll=0.3)
with Ledger.open(folder + "/ledger.sqlite", model=model) as ledger:
    run_campaign(model, inputs, ledger=ledger, executor=executor)
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, pytest.param(signal.SIGINT, marks=pytest.mark.long)])
def test_a_stopped_driver_repeats_nothing_and_loses_nothing(slurm, tmp_path, number):
    model = Counted(str(tmp_path), Slow(seconds=1.0))
    array(tmp_path, model)
    with subprocess.Popen([sys.executable, "-c", DRIVER, str(tmp_path), TASK, "12"], stderr=subprocess.PIPE) as driver:
        assert wait_until(lambda: (tmp_path / "ledger.sqlite").exists() and counts(tmp_path).ok >= 2, 60)
        driver.send_signal(number)
        driver.wait(30)
    before = counts(tmp_path)
    assert before.total == 12
    assert before.open == 12 - before.ok > 0, "the runs of the array go on; none of them is an interrupted one"
    done = campaign(tmp_path, model, 12)
    assert all(record.ok for record in done)
    assert set(calls(tmp_path).values()) == {1}
    assert len(calls(tmp_path)) == 12
    with Ledger.open(tmp_path / "ledger.sqlite", model=None, read_only=True) as ledger:
        assert [ledger.attempts(record.key) for record in done] == [1] * 12


def test_a_driver_killed_many_times_gives_no_run_up(slurm, tmp_path):
    """A start is an attempt, the coming of a driver is not: else a long array would be given up by restarts."""
    model = Counted(str(tmp_path), Slow(seconds=3.0))
    for _ in range(5):
        with pytest.raises(Detached):
            campaign(tmp_path, model, 2, detach=True)
    assert all(record.ok for record in campaign(tmp_path, model, 2))
    assert set(calls(tmp_path).values()) == {1}


def test_a_submission_whose_driver_died_before_noting_it_is_found(slurm, tmp_path):
    model = Counted(str(tmp_path), Slow(seconds=2.0))
    with pytest.raises(Detached):
        campaign(tmp_path, model, 2, detach=True)
    (job,) = (tmp_path / "slurm").glob("*/job")
    job.unlink()
    assert all(record.ok for record in campaign(tmp_path, model, 2))
    assert set(calls(tmp_path).values()) == {1}


def test_a_batch_that_was_never_submitted_is_submitted(slurm, tmp_path):
    model = Counted(str(tmp_path))
    with pytest.raises(Detached):
        campaign(tmp_path, model, 2, detach=True, extra=("--hold",))
    slurm.quiet()
    (job,) = (tmp_path / "slurm").glob("*/job")
    job.unlink()
    for path in (tmp_path / "slurm").iterdir():
        path.rename(path.with_name("strandline-never"))
    assert all(record.ok for record in campaign(tmp_path, model, 2))
    assert set(calls(tmp_path).values()) == {1}


def running(slurm, index):
    rows = slurm.command("squeue", "--noheader", "--array", "--format=%K|%T|%N").split()
    return next((row.split("|")[2] for row in rows if row.startswith(f"{index}|RUNNING")), "")


def disturbed(folder, slurm, model, number, disturb, **options):
    """Run a campaign of slow runs that `disturb` meets in its middle; return the ends, one for each attempt."""
    ends = []

    def note(record, progress):
        ends.append((record.state, record.failure_kind))
        if len(ends) == 1:
            disturb()

    done = campaign(folder, model, number, on_record=note, **options)
    return done, Counter(ends)


def first_running(slurm):
    """Return number and node of a job that has begun lately, when all of the first ones have ended."""
    time.sleep(2.0)
    rows = slurm.command("squeue", "--noheader", "--array", "--states=RUNNING", "--format=%i|%N").split()
    return rows[-1].split("|")


def test_a_cancelled_job_is_made_again(slurm, tmp_path):
    model = Counted(str(tmp_path), Slow(seconds=3.0))
    done, ends = disturbed(tmp_path, slurm, model, 10, lambda: slurm.command("scancel", first_running(slurm)[0]))
    assert all(record.ok for record in done)
    assert ends == {("ok", None): 10, ("killed", "cancelled"): 1}
    assert sum(calls(tmp_path).values()) <= 11


def test_runs_on_a_node_that_fails_are_made_again(slurm, tmp_path):
    model = Counted(str(tmp_path), Slow(seconds=4.0))

    def fail():
        node = first_running(slurm)[1]
        slurm.command("scontrol", "update", f"nodename={node}", "state=down", "reason=test")

    done, ends = disturbed(tmp_path, slurm, model, 8, fail)
    assert all(record.ok for record in done)
    assert ends[("ok", None)] == 8
    assert 1 <= ends[("killed", "node_failed")] <= 2
    assert set(ends) == {("ok", None), ("killed", "node_failed")}


def test_a_controller_that_is_killed_and_started_again_costs_nothing(slurm, tmp_path):
    model = Counted(str(tmp_path), Slow(seconds=2.0))

    def restart():
        (submitted,) = (tmp_path / "slurm").glob("*/job")
        slurm.kill_controller(saved_after=submitted.stat().st_mtime)
        time.sleep(2.0)
        slurm.start_controller()
        assert sum(calls(tmp_path).values()) < 15, "all runs had started before the controller died"

    done, ends = disturbed(tmp_path, slurm, model, 15, restart)
    assert all(record.ok for record in done)
    assert ends[("ok", None)] == 15
    assert set(ends) <= {("ok", None), ("killed", "node_failed")}, "a job may be lost on its way to its node"
    assert set(calls(tmp_path).values()) == {1}


def test_a_run_that_is_told_of_the_end_of_its_walltime_is_a_timeout(slurm, tmp_path):
    """SLURM sends SIGUSR1 to the job 45 s before the end; here the test does, for a minute is the least walltime."""
    model = Counted(str(tmp_path), Faulty(fault="hang", above=302.0))

    def running():
        return slurm.command("squeue", "--noheader", "--array", "--states=RUNNING", "--format=%i").split()

    def announce():
        assert wait_until(lambda: sum(calls(tmp_path).values()) == 3 and len(running()) == 2, 20)
        for row in running():
            slurm.command("scancel", "--batch", "--signal=USR1", row)

    done, _ = disturbed(tmp_path, slurm, model, 3, announce, walltime="00:05:00")
    assert [(record.state, record.failure_kind) for record in done] == [("ok", None), *[("timeout", "walltime")] * 2]
    assert "waiting for nothing" in done[1].message
    assert set(calls(tmp_path).values()) == {1}, "not tried again: it would take as long"


@pytest.mark.long
def test_a_run_past_its_walltime_is_a_timeout(slurm, tmp_path):
    """Even where it could not say so itself: here its own process is stopped, and SLURM ends the job."""
    model = Counted(str(tmp_path), Faulty(fault="hang", above=302.0))
    done = campaign(tmp_path, model, 2, walltime="00:01:00", extra=("--signal=B:USR1@5",))
    assert [(record.state, record.failure_kind) for record in done] == [("ok", None), ("timeout", "walltime")]


def test_a_queue_full_of_other_jobs_is_waited_for(slurm, tmp_path):
    for _ in range(6):
        slurm.command("sbatch", "--output=/dev/null", "--wrap=sleep 4")
    began = time.monotonic()
    done = campaign(tmp_path, Counted(str(tmp_path)), 3)
    assert all(record.ok for record in done)
    assert time.monotonic() - began > 3.0
    assert set(calls(tmp_path).values()) == {1}


def test_at_most_so_many_run_at_a_time(slurm, tmp_path):
    model = Counted(str(tmp_path), Slow(seconds=1.0))
    with pytest.raises(Detached):
        campaign(tmp_path, model, 4, detach=True, max_running=1)
    assert wait_until(lambda: sum(calls(tmp_path).values()) == 2, 30)
    assert len(slurm.command("squeue", "--noheader", "--array", "--states=RUNNING").splitlines()) <= 1


def test_what_slurm_refuses_is_one_clear_error_and_costs_no_attempt(slurm, tmp_path):
    model = Counted(str(tmp_path))
    with pytest.raises(InvalidInput, match=r"sbatch failed.*invalid partition.*sinfo"):
        campaign(tmp_path, model, 3, partition="nowhere")
    assert not list((tmp_path / "slurm").iterdir())
    assert all(record.ok for record in campaign(tmp_path, model, 3))
    with Ledger.open(tmp_path / "ledger.sqlite", model=None, read_only=True) as ledger:
        assert {ledger.attempts(record.key) for record in ledger} == {1}


def test_arrays_larger_than_slurm_allows_are_cut(slurm, tmp_path, monkeypatch):
    monkeypatch.setattr("strandline.runs.executors.slurm_commands.largest_array", lambda: 4)
    done = campaign(tmp_path, Counted(str(tmp_path)), 10)
    assert all(record.ok for record in done)
    assert counts(tmp_path) == Counts(ok=10)


def test_a_model_that_has_changed_stops_the_array(slurm, tmp_path):
    array(tmp_path, Cantilever(length=2.0))
    model = Cantilever()
    with pytest.raises(InvalidInput, match="model has changed since the runs were submitted"):
        campaign(tmp_path, model, 3)
    assert wait_until(lambda: not slurm.command("squeue", "--noheader"), 20)
    (tmp_path / "model.pickle").unlink()
    assert all(record.ok for record in campaign(tmp_path, model, 3))


def test_a_damaged_result_is_made_again(slurm, tmp_path):
    model = Counted(str(tmp_path))
    with pytest.raises(Detached):
        campaign(tmp_path, model, 2, detach=True)
    assert wait_until(lambda: len(list((tmp_path / "slurm").glob("*/results/*.run"))) == 2, 30)
    (path,) = (tmp_path / "slurm").glob("*/results/1.run")
    content = path.read_bytes()
    path.write_bytes(content[:-100] + bytes(100))
    done = campaign(tmp_path, model, 2)
    assert all(record.ok for record in done)
    assert sorted(calls(tmp_path).values()) == [1, 2]


def test_a_job_that_comes_after_its_batch_was_given_up_does_nothing(slurm, tmp_path):
    model = Counted(str(tmp_path))
    done = subprocess.run(
        [sys.executable, TASK, str(tmp_path / "model.pickle"), str(tmp_path / "gone"), "0"], check=False
    )
    assert done.returncode == 0
    assert not calls(tmp_path)
    assert model


def test_without_slurm_there_is_one_clear_error(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    executor = array(tmp_path, Cantilever())
    with pytest.raises(InvalidInput, match=r"no command .*Run it where jobs are submitted"):
        list(executor(Cantilever(), requests_for(Cantilever())))
    assert os.environ["PATH"] == str(tmp_path)
