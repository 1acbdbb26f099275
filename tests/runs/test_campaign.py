"""Campaigns: what is run, what is not, and that a killed driver costs nothing but the runs that it was making."""

import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from collections import Counter
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from strandline.errors import InvalidInput, LedgerError, NumericsError
from strandline.models.protocol import fingerprint
from strandline.runs import (
    Counts,
    InProcess,
    Ledger,
    LocalProcesses,
    Progress,
    RunRecord,
    RunRequest,
    run_campaign,
    run_key,
)
from strandline.testing.executors import same_outcome
from strandline.testing.models import Cantilever, Counted, CrashesOnce, Faulty, Patient, Slow, TwoLoads


@pytest.fixture
def path(tmp_path):
    return tmp_path / "ledger.sqlite"


def design(*stiffness):
    return [{"E": float(value), "load": 1e-5} for value in stiffness]


def campaign(path, model, inputs, executor=None, **options):
    with Ledger.open(path, model=model) as ledger:
        return run_campaign(model, inputs, ledger=ledger, executor=executor or InProcess(), **options)


def counts(path):
    with Ledger.open(path, model=None, read_only=True) as ledger:
        return ledger.counts()


def calls(folder):
    """Return how often each run was begun."""
    file = folder / "calls"
    lines = file.read_text().splitlines() if file.exists() else []
    return Counter(line.partition(" ")[2] for line in lines)


def test_results_come_in_the_order_of_the_design(path, tmp_path):
    (tmp_path / "marks").mkdir()
    model = Patient(str(tmp_path / "marks"), others=2)
    inputs = design(600, 400, 300)
    completed = []

    def mark(record, progress):
        completed.append(record.inputs["E"])
        (tmp_path / "marks" / str(progress.finished)).touch()

    done = campaign(path, model, inputs, LocalProcesses(2), on_record=mark)
    assert completed == [400.0, 300.0, 600.0]
    assert [dict(record.inputs) for record in done] == inputs
    for record in done:
        direct = Cantilever()(record.inputs, tmp_path)
        assert record.interface.points.tobytes() == direct.interface.points.tobytes()


def test_a_second_campaign_runs_only_what_is_missing(path, tmp_path):
    model = Counted(str(tmp_path))
    first = campaign(path, model, design(300, 400))
    seen = []
    second = campaign(path, model, design(300, 500, 400), on_record=lambda r, p: seen.append((r.inputs["E"], p)))
    assert max(calls(tmp_path).values()) == 1
    assert len(calls(tmp_path)) == 3
    assert same_outcome(first[0], second[0])
    assert same_outcome(first[1], second[2])
    ((stiffness, progress),) = seen
    assert stiffness == 500.0
    assert progress == Progress(3, 3, 3, 0, 2, progress.elapsed)


class Noted:
    """An executor in this process that notes what it runs."""

    def __init__(self):
        self.made = []

    def __call__(self, model, requests):
        for record in InProcess()(model, requests):
            self.made.append(record.inputs["E"])
            yield record


def test_runs_without_sensitivities_are_made_again_where_they_are_asked_for(path):
    plain, asked, inputs = TwoLoads(), TwoLoads(sensitivities=True), design(300, 400, -1)
    first = campaign(path, plain, inputs)
    executor = Noted()
    second = campaign(path, asked, [*inputs, *design(500)], executor)
    assert executor.made == [300.0, 400.0, 500.0]
    assert [list(record.sensitivities) for record in second] == [["light", "heavy"]] * 2 + [[]] + [["light", "heavy"]]
    for one, other in zip(first, second, strict=False):
        for condition, interface in one.interfaces.items():
            assert other.interfaces[condition].points.tobytes() == interface.points.tobytes()
    idle = Noted()
    assert all(
        same_outcome(*pair) for pair in zip(second, campaign(path, asked, [*inputs, *design(500)], idle), strict=True)
    )
    third = campaign(path, plain, inputs, idle)
    assert idle.made == []
    assert all(same_outcome(*pair) for pair in zip(third, second, strict=False)), "the newer outcome counts"
    assert outcomes_per_run(path) == [
        (run_key(plain.fingerprint, entry), n) for entry, n in sorted_by_key(plain, inputs)
    ]


def sorted_by_key(model, inputs):
    """Return each run with the number of its outcomes in the test above."""
    numbers = zip([*inputs, *design(500)], (2, 2, 1, 1), strict=True)
    return sorted(numbers, key=lambda item: run_key(model.fingerprint, item[0]))


class Dies:
    """An executor whose worker dies on each run."""

    def __call__(self, model, requests):
        for request in requests:
            yield RunRecord(request.key, request.inputs, "killed", failure_kind="worker_died", message="gone")


def test_a_run_that_dies_only_with_its_sensitivities_is_given_up(path):
    campaign(path, TwoLoads(), design(300))
    (record,) = campaign(path, TwoLoads(sensitivities=True), design(300), Dies())
    assert (record.state, record.failure_kind) == ("killed", "worker_died")
    with Ledger.open(path, model=None, read_only=True) as ledger:
        assert ledger.attempts(record.key) == 4
        assert ledger.open_attempts(record.key) == 3


def test_a_run_that_is_lost_only_with_its_sensitivities_keeps_its_interface(path):
    (before,) = campaign(path, TwoLoads(), design(300))
    with Ledger.open(path, model=fingerprint(TwoLoads())) as ledger:
        for _ in range(3):
            ledger.started(RunRequest(before.key, before.inputs))
    (record,) = campaign(path, TwoLoads(sensitivities=True), design(300), Noted())
    assert same_outcome(record, before)


def test_only_runs_with_sensitivities_are_copied_where_they_are_asked_for(path, tmp_path):
    inputs, other = design(300, 400, -1), tmp_path / "other.sqlite"
    (steep,) = campaign(other, TwoLoads(sensitivities=True), inputs[:1])
    campaign(other, TwoLoads(), inputs)
    keys = [run_key(fingerprint(TwoLoads()), entry) for entry in inputs]
    campaign(path, TwoLoads(), inputs[:1])
    with Ledger.open(path, model=fingerprint(TwoLoads())) as ledger:
        assert ledger.copy_from(other, keys, sensitivities=True) == 2
        found = ledger.latest(keys)
        assert [key in found for key in keys] == [True, False, True]
        assert same_outcome(found[keys[0]], steep)
        assert ledger.copy_from(other, keys) == 1


def test_equal_inputs_run_once(path, tmp_path):
    done = campaign(path, Counted(str(tmp_path)), design(300, 400, 300, 300))
    assert calls(tmp_path).total() == 2
    assert len(done) == 4
    assert done[0] is done[2] is done[3]


def test_failures_are_data_and_final(path):
    model = Faulty(fault="exception", above=450.0)
    progress = []
    inputs = design(400, 500, -1)
    done = campaign(path, model, inputs, on_record=lambda _, p: progress.append(p))
    assert [r.state for r in done] == ["ok", "failed", "failed"]
    assert [r.failure_kind for r in done] == [None, "exception", "nonpositive_stiffness"]
    assert [(p.total, p.finished, p.ok, p.failed) for p in progress] == [(3, 1, 1, 0), (3, 2, 1, 1), (3, 3, 1, 2)]
    assert progress[0].remaining_seconds == pytest.approx(2 * progress[0].elapsed)
    again = campaign(path, model, inputs, on_record=lambda *_: pytest.fail("nothing was missing"))
    assert all(same_outcome(one, other) for one, other in zip(done, again, strict=True))


def test_a_run_whose_process_vanished_is_tried_again(path, tmp_path):
    (tmp_path / "marks").mkdir()
    states = []
    model = CrashesOnce(str(tmp_path / "marks"))
    done = campaign(
        path, model, design(300, 400, 500), LocalProcesses(2), on_record=lambda r, _: states.append(r.state)
    )
    assert [r.state for r in done] == ["ok"] * 3
    assert Counter(states) == {"killed": 3, "ok": 3}
    assert counts(path) == Counts(ok=3)


def test_a_run_that_kills_each_process_is_given_up(path, tmp_path):
    model = Counted(str(tmp_path), Faulty(fault="kill", above=450.0))
    done = campaign(path, model, design(400, 500), LocalProcesses(1), maximum_attempts=2)
    assert [r.state for r in done] == ["ok", "killed"]
    assert "SIGKILL" in done[1].message
    assert sorted(calls(tmp_path).values()) == [1, 2]
    again = campaign(path, model, design(400, 500), LocalProcesses(1), maximum_attempts=2)
    assert "raise maximum_attempts" in again[1].message
    assert sorted(calls(tmp_path).values()) == [1, 2]
    campaign(path, model, design(400, 500), LocalProcesses(1), maximum_attempts=3)
    assert sorted(calls(tmp_path).values()) == [1, 3]


def test_a_run_lost_with_its_driver_too_often_is_given_up(path):
    """A simulator that takes an in-process driver down would otherwise do so for ever."""
    model = Cantilever()
    (inputs,) = design(400)
    for _ in range(2):
        with Ledger.open(path, model=model) as ledger:
            ledger.started(RunRequest(run_key(fingerprint(model), inputs), inputs))
    (given_up,) = campaign(path, model, [inputs], maximum_attempts=2)
    assert (given_up.state, given_up.failure_kind) == ("killed", "lost")
    (done,) = campaign(path, model, [inputs], maximum_attempts=3)
    assert done.ok


def test_interruption_keeps_what_is_finished_and_costs_no_attempt(path, tmp_path):
    model = Counted(str(tmp_path))

    def stop_after_two(record, progress):
        if progress.finished == 2:
            raise KeyboardInterrupt

    for _ in range(5):
        with pytest.raises(KeyboardInterrupt):
            campaign(path, model, design(300, 400, 500, 600), on_record=stop_after_two, maximum_attempts=1)
        if counts(path).ok == 2:
            break
    assert counts(path) == Counts(ok=2)

    def interrupted(inputs, workdir):
        raise KeyboardInterrupt

    interrupted.fingerprint = model.fingerprint
    with pytest.raises(KeyboardInterrupt):
        campaign(path, interrupted, design(300, 400, 500, 600), maximum_attempts=1)
    assert counts(path) == Counts(ok=2, killed=1)
    done = campaign(path, model, design(300, 400, 500, 600), maximum_attempts=1)
    assert all(record.ok for record in done)
    assert max(calls(tmp_path).values()) == 1


def test_each_run_is_started_in_the_ledger_before_it_runs(path):
    model = Cantilever()
    seen = []
    with Ledger.open(path, model=model) as ledger:

        def peeking(model, requests):
            for request in requests:
                seen.append(ledger.counts().open)
                yield from InProcess()(model, [request])

        run_campaign(model, design(300, 400, 500), ledger=ledger, executor=peeking)
    assert seen == [1, 1, 1]


def test_ledger_of_another_model_is_refused(path):
    with Ledger.open(path, model="other") as ledger, pytest.raises(LedgerError, match="another model"):
        run_campaign(Cantilever(), design(300), ledger=ledger, executor=InProcess())


def test_no_attempt_is_refused(path):
    with pytest.raises(InvalidInput, match="maximum_attempts"):
        campaign(path, Cantilever(), design(300), maximum_attempts=0)


def test_an_executor_that_does_nothing_is_an_error_and_not_an_endless_loop(path):
    with pytest.raises(NumericsError, match="without starting"):
        campaign(path, Cantilever(), design(300), lambda model, requests: iter(()))


def answering(answer):
    """Return an executor that answers each request with what `answer` makes of its record."""

    def execute(model, requests):
        for record in InProcess()(model, requests):
            yield from answer(record)

    return execute


@pytest.mark.parametrize(
    ("executor", "said"),
    [
        (lambda model, requests: None, "got a NoneType; expected records"),
        (answering(lambda record: [record.interface]), "got a Interface; expected a RunRecord"),
        (answering(lambda record: [record, record]), "one record for each"),
        (answering(lambda record: [replace(record, key="another")]), "a record of the run another"),
    ],
    ids=["nothing", "interface", "twice", "unknown"],
)
def test_an_executor_that_answers_wrongly_is_named(path, executor, said):
    with pytest.raises(InvalidInput, match=f"what the executor function yields: .*{said}"):
        campaign(path, Cantilever(), design(400.0, 500.0), executor)


def test_an_executor_that_forgets_a_run_has_it_tried_again_and_given_up(path):
    def forgetful(model, requests):
        list(requests)
        return iter(())

    (record,) = campaign(path, Cantilever(), design(300), forgetful, maximum_attempts=3)
    assert (record.state, record.failure_kind) == ("killed", "lost")


DRIVER = """
import sys
from strandline.models.protocol import fingerprint
from strandline.runs import Ledger, LocalProcesses, run_campaign
from strandline.testing.models import Cantilever, Counted, Faulty, Slow
folder, number = sys.argv[1], int(sys.argv[2])
model = Counted(folder, Slow(Faulty(fault="exception", above=480.0), seconds=0.02))
inputs = [{"E": 300.0 + 200.0 * k / number, "load": 1e-5} for k in range(number)]
with Ledger.open(folder + "/ledger.sqlite", model=model) as ledger:
    run_campaign(model, inputs, ledger=ledger, executor=LocalProcesses(2), maximum_attempts=100)
"""


def outcomes_per_run(path):
    with closing(sqlite3.connect(path)) as connection:
        return connection.execute(
            "SELECT key, count(*) FROM outcomes JOIN starts USING (attempt) GROUP BY key"
        ).fetchall()


def snapshot(path, model):
    """Return all finished runs of the ledger of a driver that is no more."""
    if not path.exists():
        return {}
    with Ledger.open(path, model=model, read_only=True) as ledger:
        return {record.key: record for record in ledger}


def bits(record):
    points = None if record.interface is None else record.interface.points.tobytes()
    return record.key, record.state, points, record.seconds, record.message


@pytest.mark.parametrize("kills", [3, pytest.param(6, marks=pytest.mark.long)])
def test_a_driver_killed_at_random_moments_loses_and_repeats_nothing(path, tmp_path, kills):
    number, rng = 240, random.Random(20220824)
    model = Counted(str(tmp_path), Faulty(fault="exception", above=480.0))
    before, growth = {}, []
    environment = {**os.environ, "TMPDIR": str(tmp_path)}  # for the folders that killed drivers leave behind
    for _ in range(kills):
        with subprocess.Popen([sys.executable, "-c", DRIVER, str(tmp_path), str(number)], env=environment) as driver:
            target = min(len(before) + rng.randrange(1, 9), number - 1)
            deadline = time.monotonic() + 30
            while len(snapshot(path, model.fingerprint)) < target and time.monotonic() < deadline:
                time.sleep(0.01)
            time.sleep(rng.uniform(0, 0.03))
            driver.send_signal(signal.SIGKILL)
        after = snapshot(path, model.fingerprint)
        assert {key: bits(after[key]) for key in before} == {key: bits(r) for key, r in before.items()}
        growth.append(len(after) - len(before))
        before = after
    assert all(growth)
    assert len(before) < number
    done = subprocess.run([sys.executable, "-c", DRIVER, str(tmp_path), str(number)], check=False)
    assert done.returncode == 0
    final = snapshot(path, model.fingerprint)
    assert {key: bits(final[key]) for key in before} == {key: bits(r) for key, r in before.items()}
    assert repeated(path) == 0
    assert_complete(path, final, model, number, tmp_path)


def assert_complete(path, final, model, number, folder):
    """Every run of the design has the outcome that the model gives when it is called directly."""
    inputs = [{"E": 300.0 + 200.0 * k / number, "load": 1e-5} for k in range(number)]
    assert set(final) == {run_key(model.fingerprint, entry) for entry in inputs}
    for entry in inputs:
        record = final[run_key(model.fingerprint, entry)]
        assert record.state == ("failed" if entry["E"] > 480.0 else "ok")
        if record.ok:
            assert record.interface.points.tobytes() == Cantilever()(entry, folder).interface.points.tobytes()
    assert counts(path).total == number


def repeated(path):
    return sum(number - 1 for _, number in outcomes_per_run(path))


class Forgetful(Ledger):
    """A planted bug: a ledger that does not find what it holds."""

    def latest(self, keys):
        return {}


def test_the_count_of_repeated_runs_sees_a_forgetful_ledger(path):
    model = Cantilever()
    for _ in range(2):
        with Forgetful.open(path, model=fingerprint(model)) as ledger:
            run_campaign(model, design(300, 400), ledger=ledger, executor=InProcess())
    assert repeated(path) == 2


def test_killed_worker_is_the_end_of_one_attempt_only(path, tmp_path):
    """An innocent worker is shot from outside while it works: its run is repeated, no other."""
    model = Counted(str(tmp_path), Slow(seconds=0.3))
    shot = []

    def shoot(record, progress):
        if not shot:
            time.sleep(0.1)
            begun = [line.partition(" ")[::2] for line in (tmp_path / "calls").read_text().splitlines()]
            ended = {line.partition(" ")[2] for line in (tmp_path / "ends").read_text().splitlines()}
            running = [int(pid) for pid, run in begun if run not in ended]
            shot.append(running[-1])
            os.kill(running[-1], signal.SIGKILL)

    done = campaign(path, model, design(*np.linspace(300, 400, 6)), LocalProcesses(2), on_record=shoot)
    assert all(record.ok for record in done)
    assert sorted(calls(tmp_path).values()) == [1, 1, 1, 1, 1, 2]


def test_a_killed_record_says_how_its_process_ended(path):
    records: list[RunRecord] = []
    model = Faulty(fault="exit", above=0.0)
    campaign(path, model, design(300), LocalProcesses(1), on_record=lambda r, _: records.append(r), maximum_attempts=2)
    assert [r.state for r in records] == ["killed", "killed"]
    assert all("exit code 3" in r.message and "about to leave" in r.message for r in records)
