"""Campaigns in batches: what a choice is made from and when, slow runs, failures, interruptions, resumption."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from strandline.errors import CampaignStopped, InvalidInput, LedgerError
from strandline.models.protocol import fingerprint
from strandline.runs import (
    NOT_NOW,
    Counts,
    FailurePolicy,
    InProcess,
    Ledger,
    LocalProcesses,
    Retry,
    RunRecord,
    RunRequest,
    run_batches,
    run_key,
)
from strandline.runs.campaign import Starts
from strandline.testing.executors import same_outcome
from strandline.testing.models import Cantilever, Counted, CrashesOnce, Faulty, Patient, Slow

LOAD = 1e-5


@pytest.fixture
def path(tmp_path):
    return tmp_path / "ledger.sqlite"


@pytest.fixture
def marks(tmp_path):
    (tmp_path / "marks").mkdir()
    return tmp_path / "marks"


def batch(*stiffness):
    return [{"E": float(value), "load": LOAD} for value in stiffness]


def stiffnesses(records):
    return [record.inputs["E"] for record in records]


def campaign(path, model, batches, choose, executor=None, *, patience=float("inf"), **options):
    """Make a campaign; on a busy machine any run may be slow, and where that is not the point all are waited for."""
    options |= {"executor": executor or LocalProcesses(2), "patience": patience}
    with Ledger.open(path, model=model) as ledger:
        return run_batches(model, batches, choose, ledger=ledger, **options)


def counts(path):
    with Ledger.open(path, model=None, read_only=True) as ledger:
        return ledger.counts()


class Choice:
    """Gives the listed batches, then an empty one; notes what it was shown.

    With `marks`, it lets the patient runs go on when it is asked and has no batch left: no sooner, however slow the
    machine is.
    """

    def __init__(self, *batches, marks=None):
        self.left, self.shown, self.marks = list(batches), [], marks

    def __call__(self, records):
        self.shown.append(stiffnesses(records))
        if self.marks and not self.left:
            (self.marks / "done").touch()
        return self.left.pop(0) if self.left else []


class Plain:
    """Another executor without its capability to wait; notes what it was called for."""

    def __init__(self, executor):
        self.executor, self.calls = executor, []

    def __call__(self, model, requests):
        asked = list(requests)
        self.calls.append([request.inputs.get("E") for request in asked])
        return self.executor(model, asked)


class Waits:
    """An executor in this process that takes NOT_NOW."""

    asks_again = True

    def __init__(self):
        self.calls = 0

    def __call__(self, model, requests):
        self.calls += 1
        for request in requests:
            if request is not NOT_NOW:
                yield from InProcess()(model, [request])


EXECUTORS = {
    "local": lambda: LocalProcesses(2),
    "one worker": lambda: LocalProcesses(1),
    "in process": InProcess,
    "in process, waiting": Waits,
    "a call for each batch": lambda: Plain(LocalProcesses(2)),
}


@pytest.fixture(params=EXECUTORS.values(), ids=EXECUTORS.keys())
def executor(request):
    return request.param()


def follows(records):
    """Return two runs that depend on the bits of all interfaces and on their order, until there are eight."""
    number = 0.0
    for record in records:
        number = (0.37 * number + 1e7 * record.interface.points[:, 1].max() ** 2) % 100.0
    return batch(300.0 + number, 450.0 - number / 3) if len(records) < 8 else []


def expected_course(first):
    """Return all runs that follow from `first`, from calls of the model itself."""
    design = list(first)
    while True:
        interfaces = [Cantilever()(inputs, Path()).interfaces for inputs in design]
        chosen = follows([RunRecord("", inputs, "ok", found) for inputs, found in zip(design, interfaces, strict=True)])
        if not chosen:
            return design
        design += chosen


def test_each_batch_follows_from_all_records_in_the_order_of_the_design(path, executor):
    shown = []

    def choose(records):
        shown.append(stiffnesses(records))
        return follows(records)

    first = batch(400, 300, 350)
    done = campaign(path, Cantilever(), [first], choose, executor)
    design = expected_course(first)
    assert len({entry["E"] for entry in design}) == len(design) == 9
    assert [dict(record.inputs) for record in done] == design
    assert shown == [[entry["E"] for entry in design[:number]] for number in (3, 5, 7, 9)]
    for record in done:
        direct = Cantilever()(record.inputs, Path())
        assert record.interface.points.tobytes() == direct.interface.points.tobytes()


def test_batches_chosen_before_are_run_first_and_only_what_follows_is_chosen(path, executor):
    choice, seen = Choice(batch(500)), []
    done = campaign(
        path,
        Cantilever(),
        [batch(400, 300), batch(350)],
        choice,
        executor,
        on_record=lambda record, progress: seen.append((progress.total, progress.finished)),
    )
    assert stiffnesses(done) == [400.0, 300.0, 350.0, 500.0]
    assert choice.shown == [[400.0, 300.0, 350.0], [400.0, 300.0, 350.0, 500.0]]
    assert seen == [(3, 1), (3, 2), (3, 3), (4, 4)]


def test_runs_that_are_known_are_not_made_again(path, tmp_path, executor):
    model = Counted(str(tmp_path))
    campaign(path, model, [batch(300, 400)], Choice(), executor)
    choice = Choice(batch(300, 300), batch(400, 500), batch(500))
    done = campaign(path, model, [batch(400)], choice, executor)
    assert stiffnesses(done) == [400.0, 300.0, 300.0, 400.0, 500.0, 500.0]
    assert [len(shown) for shown in choice.shown] == [1, 3, 5, 6]
    assert len((tmp_path / "calls").read_text().splitlines()) == 3
    assert done[1] is done[2]


def test_a_campaign_all_of_which_is_known_starts_no_worker(path):
    campaign(path, Cantilever(), [batch(300)], Choice(batch(400)))

    def refusing(model, requests):
        raise AssertionError("there was nothing to run")

    choice = Choice(batch(400))
    done = campaign(path, Cantilever(), [batch(300)], choice, refusing)
    assert stiffnesses(done) == [300.0, 400.0]
    assert choice.shown == [[300.0], [300.0, 400.0]]


def marking(marks, stiffness):
    """Return an `on_record` that lets the patient runs go on when a certain run is done."""

    def note(record, progress):
        if record.inputs["E"] == stiffness:
            (marks / "done").touch()

    return note


def test_a_slow_run_waits_for_a_run_of_the_batch_after_the_next(path, marks):
    """It can end early only if two batches are chosen and made while it is under way."""
    model = Slow(Patient(str(marks), others=1, longest=60.0), seconds=1.5)  # more than a busy machine may stall
    choice, order = Choice(batch(300, 350), batch(450), marks=marks), []
    begin = time.monotonic()

    def note(record, progress):
        order.append(record.inputs["E"])

    done = campaign(path, model, [batch(600, 400)], choice, on_record=note, patience=3.0)
    assert order == [400.0, 300.0, 350.0, 450.0, 600.0]
    assert time.monotonic() - begin < 50.0
    assert choice.shown == [[400.0], [400.0, 300.0, 350.0], [400.0, 300.0, 350.0, 450.0]]
    assert stiffnesses(done) == [600.0, 400.0, 300.0, 350.0, 450.0]
    assert all(record.ok for record in done), "the slow run was waited for in the end"


def test_a_slow_run_that_has_ended_is_shown_in_its_place(path, marks):
    model = Slow(Patient(str(marks), others=1, longest=60.0), seconds=0.5)
    choice = Choice(batch(300), batch(350))

    def choose(records):
        if len(choice.shown) == 1:
            time.sleep(2.0)  # the slow run, which may go on now, ends meanwhile
        return choice(records)

    campaign(path, model, [batch(600, 400)], choose, on_record=marking(marks, 300.0), patience=3.0)
    assert choice.shown[0] == [400.0]
    assert choice.shown[2] == [600.0, 400.0, 300.0, 350.0]


@pytest.mark.parametrize(
    ("first", "options"),
    [
        pytest.param((600, 400), {"patience": float("inf")}, id="infinite patience"),
        pytest.param((600, 700, 400), {"patience": 3.0}, id="less than half is settled"),
        pytest.param((400, 400, 400, 600, 700), {"patience": 3.0}, id="less than half of the distinct runs is settled"),
    ],
)
def test_where_it_is_not_for_slow_runs_to_be_left_behind_all_are_waited_for(path, marks, first, options):
    choice = Choice(batch(300))
    campaign(path, Patient(str(marks), others=1, longest=2.5), [batch(*first)], choice, LocalProcesses(3), **options)
    assert choice.shown[0] == [float(value) for value in first]


def test_the_longest_run_counts_even_if_an_earlier_campaign_made_it(path, marks):
    model = Patient(str(marks), others=1, longest=2.5)
    (inputs,) = batch(450)
    key = run_key(model.fingerprint, inputs)
    with Ledger.open(path, model=model.fingerprint) as ledger:
        ledger.started(RunRequest(key, inputs))
        ledger.finished(RunRecord(key, inputs, "failed", seconds=1000.0, failure_kind="exception"))
    choice = Choice(batch(300))
    campaign(path, model, [[inputs], batch(600, 400)], choice, patience=3.0)
    assert choice.shown[0] == [450.0, 600.0, 400.0]


def test_a_choice_beside_a_slow_run_knows_every_record_that_there_is(path, marks):
    """The slow run is slow long before the last of the others ends, and that one must not be overlooked."""
    model = Slow(Patient(str(marks), others=1, longest=60.0), seconds=0.5)
    quick = [300.0, 310.0, 320.0, 330.0, 340.0, 350.0]
    choice = Choice(batch(450), marks=marks)
    campaign(path, model, [batch(600, *quick)], choice, patience=3.0)
    assert choice.shown == [quick, [*quick, 450.0]]


def test_the_time_that_the_driver_takes_for_itself_makes_no_run_slow(path):
    """While a record is dealt with, the other run ends; it lies there when the next batch is chosen."""
    choice = Choice(batch(450))

    def pause(record, progress):
        time.sleep(3.0 if progress.finished == 1 else 0.0)

    campaign(path, Slow(seconds=0.3), [batch(300, 400)], choice, on_record=pause, patience=3.0)
    assert choice.shown == [[300.0, 400.0], [300.0, 400.0, 450.0]]


def test_workers_are_kept_from_batch_to_batch(path, tmp_path):
    model = Counted(str(tmp_path))

    def processes(choice, executor):
        (tmp_path / "calls").unlink(missing_ok=True)
        campaign(path, model, [batch(*choice.left.pop(0))], Choice(*(batch(*each) for each in choice.left)), executor)
        return {line.split()[0] for line in (tmp_path / "calls").read_text().splitlines()}

    assert len(processes(Choice((300, 310), (320, 330), (340, 350), (360, 370, 380)), LocalProcesses(2))) <= 2
    again = Choice((400, 410), (420, 430), (440, 450), (460, 470, 480))
    assert len(processes(again, Plain(LocalProcesses(2)))) > 2, "the count sees workers that are not kept"


@pytest.mark.parametrize(
    ("fault", "state", "plain"),
    [
        ("exception", "failed", False),
        ("kill", "killed", False),
        ("kill", "killed", True),
        ("hang", "timeout", False),
    ],
)
def test_failed_runs_are_shown_like_others_and_harm_none(path, tmp_path, fault, state, plain):
    model, states = Counted(str(tmp_path), Faulty(fault=fault, above=500.0)), []

    def choose(records):
        states.append([record.state for record in records])
        return [batch(350, 700), batch(300), []][len(states) - 1]

    executor = LocalProcesses(2, timeout=2.0)
    done = campaign(
        path,
        model,
        [batch(400, 600)],
        choose,
        Plain(executor) if plain else executor,
        maximum_attempts=2,
    )
    assert states == [["ok", state], ["ok", state, "ok", state], ["ok", state, "ok", state, "ok"]]
    assert [record.state for record in done] == states[-1]
    attempts = Counter(line.partition(" ")[2] for line in (tmp_path / "calls").read_text().splitlines())
    assert sorted(attempts.values()) == ([1, 1, 1, 2, 2] if state == "killed" else [1] * 5)


def test_a_run_whose_process_vanished_is_tried_again_before_its_batch_is_closed(path, marks):
    states, choice = [], Choice(batch(500))
    model = CrashesOnce(str(marks))
    done = campaign(path, model, [batch(300, 400)], choice, on_record=lambda record, _: states.append(record.state))
    assert Counter(states) == {"killed": 3, "ok": 3}
    assert [record.state for record in done] == ["ok"] * 3
    assert choice.shown == [[300.0, 400.0], [300.0, 400.0, 500.0]]
    assert counts(path) == Counts(ok=3)


def test_a_run_is_tried_again_beside_a_slow_one(path, tmp_path, marks):
    (tmp_path / "crashed").mkdir()
    patient = Slow(Patient(str(marks), others=1, longest=60.0), seconds=0.5)
    choice, ends = Choice(batch(450), marks=marks), []

    def note(record, progress):
        ends.append((record.inputs["E"], record.state))

    model = CrashesOnce(str(tmp_path / "crashed"), patient)
    campaign(path, model, [batch(600, 400)], choice, on_record=note, patience=3.0)
    assert sorted(ends[:3]) == [(400.0, "killed"), (400.0, "ok"), (600.0, "killed")]
    assert ends[3:] == [(450.0, "killed"), (450.0, "ok"), (600.0, "ok")]
    assert choice.shown == [[400.0], [400.0, 450.0]]


class Hesitates:
    """An executor that leaves when it is told to wait, and once before without an answer."""

    asks_again = True

    def __init__(self):
        self.forgotten = 0

    def __call__(self, model, requests):
        for request in requests:
            if request is NOT_NOW:
                return
            if not self.forgotten:
                self.forgotten += 1
                continue
            yield from InProcess()(model, [request])


def test_an_executor_that_ends_early_is_called_again(path):
    choice = Choice(batch(350, 360), batch(370))
    done = campaign(path, Cantilever(), [batch(300, 400)], choice, Hesitates())
    assert stiffnesses(done) == [300.0, 400.0, 350.0, 360.0, 370.0]
    assert [len(shown) for shown in choice.shown] == [2, 4, 5]


class Moody:
    """Fails the first `times` times at each stiffness above 500; counts its calls."""

    fingerprint = "test:moody-batches"

    def __init__(self, times):
        self.times, self.calls = times, Counter()

    def __call__(self, inputs, workdir):
        self.calls[inputs["E"]] += 1
        if inputs["E"] > 500.0 and self.calls[inputs["E"]] <= self.times:
            raise RuntimeError("not in the mood")
        return Cantilever()(inputs, workdir)


@pytest.mark.parametrize("executor", [Waits, InProcess], ids=["waits", "a call for each batch"])
def test_the_policy_is_heeded(tmp_path, executor):
    model, choice = Moody(2), Choice(batch(350, 700))
    retry = FailurePolicy({"failed": Retry(2)}, stop_share=2.0)
    done = campaign(tmp_path / "retry.sqlite", model, [batch(600, 400)], choice, executor(), policy=retry)
    assert [record.state for record in done] == ["ok"] * 4
    assert model.calls == {600.0: 3, 400.0: 1, 350.0: 1, 700.0: 3}
    assert choice.shown == [[600.0, 400.0], [600.0, 400.0, 350.0, 700.0]]

    model, abort = Moody(1), FailurePolicy({"failed": "abort"})
    with pytest.raises(CampaignStopped, match="not in the mood"):
        campaign(
            tmp_path / "abort.sqlite", model, [batch(400)], Choice(batch(600), batch(300)), executor(), policy=abort
        )
    assert model.calls == {400.0: 1, 600.0: 1}
    done = campaign(tmp_path / "abort.sqlite", model, [batch(400), batch(600)], Choice(), executor(), policy=abort)
    assert [record.state for record in done] == ["ok", "ok"]

    model, mostly = Moody(9), FailurePolicy(stop_after=4, stop_share=0.6)
    with pytest.raises(CampaignStopped, match="3 of 4 runs failed"):
        campaign(
            tmp_path / "mostly.sqlite",
            model,
            [batch(400, 600)],
            Choice(batch(700, 800, 900)),
            executor(),
            policy=mostly,
        )


def test_a_run_lost_with_earlier_drivers_is_given_up_and_shown(path):
    model, (inputs,) = Cantilever(), batch(400)
    for _ in range(2):
        with Ledger.open(path, model=model) as ledger:
            ledger.started(RunRequest(run_key(fingerprint(model), inputs), inputs))
    choice = Choice([inputs])
    done = campaign(path, model, [batch(300)], choice, maximum_attempts=2)
    assert [(record.state, record.failure_kind) for record in done] == [("ok", None), ("killed", "lost")]
    assert choice.shown == [[300.0], [300.0, 400.0]]


def test_an_interrupted_choice_costs_nothing_but_the_runs_under_way(path, marks):
    model = Patient(str(marks), others=1, longest=40.0)

    def interrupted(records):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        campaign(path, model, [batch(600, 400)], interrupted, maximum_attempts=1, patience=3.0)
    assert counts(path) == Counts(ok=1, killed=1)
    (marks / "done").touch()
    choice = Choice(batch(300))
    done = campaign(path, model, [batch(600, 400)], choice, maximum_attempts=1)
    assert choice.shown == [[600.0, 400.0], [600.0, 400.0, 300.0]]
    assert all(record.ok for record in done)


def test_an_interruption_between_records_keeps_what_is_finished(path, executor):
    def interrupt(record, progress):
        if record.inputs["E"] == 350.0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        campaign(path, Cantilever(), [batch(300, 400)], Choice(batch(350)), executor, on_record=interrupt)
    assert counts(path) == Counts(ok=3)
    done = campaign(path, Cantilever(), [batch(300, 400), batch(350)], Choice(batch(450)), executor)
    assert stiffnesses(done) == [300.0, 400.0, 350.0, 450.0]


def test_an_executor_that_cannot_wait_is_called_for_each_batch(path):
    executor, choice = Plain(InProcess()), Choice(batch(350, 360), batch(370))
    campaign(path, Cantilever(), [batch(300), batch(400)], choice, executor)
    assert executor.calls == [[300.0, 400.0], [350.0, 360.0], [370.0]]
    waiting = Waits()
    campaign(path, Cantilever(), [batch(500)], Choice(batch(510), batch(520)), waiting)
    assert waiting.calls == 1


class Elsewhere:
    """An executor whose runs go on without a driver, and which cannot wait."""

    def __init__(self):
        self.submitted, self.waiting = [], {}

    def outstanding(self, model, keys):
        return self.waiting.keys() & keys

    def __call__(self, model, requests):
        asked = list(requests)
        new = [request for request in asked if request.key not in self.waiting]
        self.submitted += [request.inputs["E"] for request in new]
        self.waiting |= {request.key: request for request in new}
        for request in asked:
            yield from InProcess()(model, [request])
            del self.waiting[request.key]


class ElsewhereWaits(Elsewhere):
    """The same for one request after the other, and with NOT_NOW."""

    asks_again = True

    def __call__(self, model, requests):
        for request in requests:
            if request is not NOT_NOW:
                yield from super().__call__(model, [request])


class ElsewhereLost(ElsewhereWaits):
    """A third, where the first run that it answers has been killed."""

    def __call__(self, model, requests):
        killed = False
        for record in super().__call__(model, requests):
            yield record if killed else replace(record, state="killed", failure_kind="node_failed", interfaces={})
            killed = True


def test_a_run_that_was_killed_without_a_driver_is_started_again(path):
    executor, choice = ElsewhereLost(), Choice(batch(350))
    (inputs,) = batch(300)
    key = run_key(fingerprint(Cantilever()), inputs)
    executor.waiting[key] = RunRequest(key, inputs)
    with Ledger.open(path, model=fingerprint(Cantilever())) as ledger:
        ledger.started(RunRequest(key, inputs))
    done = campaign(path, Cantilever(), [batch(300, 400)], choice, executor)
    assert [record.state for record in done] == ["ok"] * 3
    assert executor.submitted == [400.0, 300.0, 350.0]
    with Ledger.open(path, model=None, read_only=True) as ledger:
        assert [ledger.attempts(record.key) for record in done] == [2, 1, 1]


@pytest.mark.parametrize("kind", [Elsewhere, ElsewhereWaits])
def test_runs_that_go_on_without_a_driver_are_collected(path, kind):
    executor, choice = kind(), Choice(batch(350, 360))
    (inputs,) = batch(300)
    key = run_key(fingerprint(Cantilever()), inputs)
    executor.waiting[key] = RunRequest(key, inputs)
    with Ledger.open(path, model=fingerprint(Cantilever())) as ledger:
        ledger.started(RunRequest(key, inputs))
    done = campaign(path, Cantilever(), [batch(300, 400)], choice, executor, maximum_attempts=1)
    assert all(record.ok for record in done)
    assert executor.submitted == [400.0, 350.0, 360.0]
    assert choice.shown == [[300.0, 400.0], [300.0, 400.0, 350.0, 360.0]]


def test_the_first_who_finds_nothing_waiting_is_told_before_anyone_chooses(path):
    """An executor may pull with a record in its hands, which the choice must not miss."""
    (inputs,), asked = batch(300), []

    def further(starts):
        asked.append(sorted(starts.running))
        return

    with Ledger.open(path, model="any") as ledger:
        starts = Starts(ledger, [RunRequest("first", inputs)], set(), further)
        assert next(starts).key == "first"
        assert next(starts) is NOT_NOW
        assert asked == []
        assert list(starts) == []
        assert asked == [["first"]]


def test_a_run_is_under_way_since_its_present_attempt(path):
    (inputs,) = batch(300)
    with Ledger.open(path, model="any") as ledger:
        starts = Starts(ledger, [RunRequest("again", inputs)], set(), lambda starts: ())
        next(starts)
        first = starts.begun["again"]
        starts.put_back(RunRequest("again", inputs))
        time.sleep(0.01)
        next(starts)
        assert starts.begun["again"] > first


DRIVER = """
import json, os, sys
from strandline.models.protocol import fingerprint
from strandline.runs import InProcess, Ledger, LocalProcesses, run_batches
from strandline.testing.models import Cantilever, Counted, Slow
folder, number = sys.argv[1], int(sys.argv[2])
model = Counted(folder, Slow(seconds=0.02))
noted = folder + "/batches"

def choose(records):
    if len(records) >= number:
        return []
    total = 0.0
    for record in records:
        total = (0.37 * total + 1e7 * record.interface.points[:, 1].max() ** 2) % 100.0
    batch = [{"E": 300.0 + total + step, "load": 1e-5} for step in (0.0, 31.0, 57.0)]
    with open(noted, "a") as file:
        file.write(json.dumps(batch) + "\\n")
        file.flush()
        os.fsync(file.fileno())
    return batch

first = [[{"E": 330.0, "load": 1e-5}, {"E": 410.0, "load": 1e-5}]]
lines = open(noted).read().split("\\n")[:-1] if os.path.exists(noted) else []
with Ledger.open(folder + "/ledger.sqlite", model=model) as ledger:
    batches = [*first, *map(json.loads, lines)]
    options = {"executor": LocalProcesses(2), "patience": float("inf"), "maximum_attempts": 100}
    run_batches(model, batches, choose, ledger=ledger, **options)
"""


def snapshot(folder):
    if not (folder / "ledger.sqlite").exists():
        return {}
    with Ledger.open(folder / "ledger.sqlite", model=None, read_only=True) as ledger:
        return {record.key: record for record in ledger}


@pytest.mark.parametrize("kills", [2, pytest.param(4, marks=pytest.mark.long)])
def test_a_campaign_killed_at_random_moments_goes_on_as_it_would_have(tmp_path, kills):
    number, rng = 60, random.Random(20240229)
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    whole.mkdir()
    killed.mkdir()
    environment = {**os.environ, "TMPDIR": str(tmp_path)}  # for the folders that killed drivers leave behind
    command = [sys.executable, "-c", DRIVER]
    subprocess.run([*command, str(whole), str(number)], env=environment, check=True, timeout=120)
    for _ in range(kills):
        before = len(snapshot(killed))
        with subprocess.Popen([*command, str(killed), str(number)], env=environment) as driver:
            target, deadline = before + rng.randrange(2, 8), time.monotonic() + 60
            while len(snapshot(killed)) < target and time.monotonic() < deadline:
                time.sleep(0.01)
            time.sleep(rng.uniform(0, 0.03))
            driver.send_signal(signal.SIGKILL)
        assert before < len(snapshot(killed)) < number
    subprocess.run([*command, str(killed), str(number)], env=environment, check=True, timeout=120)
    batches = [json.loads(line) for line in (whole / "batches").read_text().splitlines()]
    assert (killed / "batches").read_text() == (whole / "batches").read_text()
    assert len({entry["E"] for chosen in batches for entry in chosen}) == 60
    once, again = snapshot(whole), snapshot(killed)
    assert once.keys() == again.keys()
    assert len(once) == 62
    assert all(same_outcome(record, again[key]) for key, record in once.items())
    ends = Counter(line.partition(" ")[2] for line in (killed / "ends").read_text().splitlines())
    assert ends.total() <= 62 + kills * 2, "more was run again than what was under way"


@pytest.mark.parametrize("batches", [[], [[]], [batch(300), []]], ids=str)
def test_there_must_be_a_first_batch(path, batches):
    with pytest.raises(InvalidInput, match="batches to begin with"):
        campaign(path, Cantilever(), batches, Choice())


@pytest.mark.parametrize("patience", [0.0, -1.0, float("nan")])
def test_senseless_patience_is_refused(path, patience):
    with pytest.raises(InvalidInput, match="patience"):
        campaign(path, Cantilever(), [batch(300)], Choice(), patience=patience)


def test_a_choice_that_runs_out_of_batches_is_an_error_and_no_silent_end(path, executor):
    batches = iter([batch(350)])
    with pytest.raises(InvalidInput, match="give `next` a default"):
        campaign(path, Cantilever(), [batch(300)], lambda records: next(batches), executor)
    assert counts(path) == Counts(ok=2)


def test_ledger_of_another_model_is_refused_for_batches(path):
    with Ledger.open(path, model="other") as ledger, pytest.raises(LedgerError, match="another model"):
        run_batches(Cantilever(), [batch(300)], Choice(), ledger=ledger, executor=InProcess())
