"""Campaigns in batches: what a choice is made from and when, slow runs, failures, interruptions, resumption."""

from dataclasses import replace
from pathlib import Path

import pytest
from tests.unit.runs.fakes import (
    Elsewhere,
    ElsewhereWaits,
    Moody,
    Noted,
    Waits,
    attempts,
    batches,
    begun_before,
    calls,
    counts,
    design,
    states,
    stiffnesses,
)

from strandline.errors import CampaignStopped, InvalidInput, LedgerError
from strandline.runs import (
    NOT_NOW,
    Counts,
    FailurePolicy,
    InProcess,
    Ledger,
    Retry,
    RunRecord,
    RunRequest,
    run_batches,
)
from strandline.runs.campaign import Starts
from strandline.testing.models import Cantilever, Counted, Faulty


class Choice:
    """Gives the listed batches, then an empty one; notes what it was shown."""

    def __init__(self, *listed):
        self.left, self.shown = list(listed), []

    def __call__(self, records):
        self.shown.append(stiffnesses(records))
        return self.left.pop(0) if self.left else []


@pytest.fixture(params=[Waits, Noted], ids=["waits", "a call for each batch"])
def executor(request):
    return request.param()


def follows(records):
    """Return two runs that depend on the bits of all interfaces and on their order, until there are eight."""
    number = 0.0
    for record in records:
        number = (0.37 * number + 1e7 * record.interface.points[:, 1].max() ** 2) % 100.0
    return design(300.0 + number, 450.0 - number / 3) if len(records) < 8 else []


def expected_course(first):
    """Return all runs that follow from `first`, from calls of the model itself."""
    runs = list(first)
    while True:
        interfaces = [Cantilever()(inputs, Path()).interfaces for inputs in runs]
        chosen = follows([RunRecord("", inputs, "ok", found) for inputs, found in zip(runs, interfaces, strict=True)])
        if not chosen:
            return runs
        runs += chosen


def test_each_batch_follows_from_all_records_in_the_order_of_the_design(path, executor):
    shown, first = [], design(400, 300, 350)

    def choose(records):
        shown.append(stiffnesses(records))
        return follows(records)

    done, course = batches(path, Cantilever(), [first], choose, executor), expected_course(first)
    assert len({entry["E"] for entry in course}) == len(course) == 9
    assert [dict(record.inputs) for record in done] == course
    assert shown == [[entry["E"] for entry in course[:number]] for number in (3, 5, 7, 9)]
    for record in done:
        direct = Cantilever()(record.inputs, Path())
        assert record.interface.points.tobytes() == direct.interface.points.tobytes()


def test_batches_chosen_before_are_run_first_and_only_what_follows_is_chosen(path, executor):
    choice, seen = Choice(design(500)), []
    note = lambda record, progress: seen.append((progress.total, progress.finished))  # noqa: E731
    done = batches(path, Cantilever(), [design(400, 300), design(350)], choice, executor, on_record=note)
    assert stiffnesses(done) == [400.0, 300.0, 350.0, 500.0]
    assert choice.shown == [[400.0, 300.0, 350.0], [400.0, 300.0, 350.0, 500.0]]
    assert seen == [(3, 1), (3, 2), (3, 3), (4, 4)]


def test_runs_that_are_known_are_not_made_again(path, tmp_path, executor):
    model = Counted(str(tmp_path))
    batches(path, model, [design(300, 400)], Choice(), executor)
    choice = Choice(design(300, 300), design(400, 500), design(500))
    done = batches(path, model, [design(400)], choice, executor)
    assert stiffnesses(done) == [400.0, 300.0, 300.0, 400.0, 500.0, 500.0]
    assert [len(shown) for shown in choice.shown] == [1, 3, 5, 6]
    assert sorted(calls(tmp_path).values()) == [1, 1, 1]
    assert done[1] is done[2]

    def refusing(model, requests):
        raise AssertionError("there was nothing to run")

    assert batches(path, model, [design(400)], Choice(design(300)), refusing)


def test_an_executor_that_cannot_wait_is_called_for_each_batch(path):
    plain, waiting = Noted(), Waits()
    batches(path, Cantilever(), [design(300), design(400)], Choice(design(350, 360), design(370)), plain)
    assert plain.calls == [[300.0, 400.0], [350.0, 360.0], [370.0]]
    batches(path, Cantilever(), [design(500)], Choice(design(510), design(520)), waiting)
    assert waiting.calls == 1


class Aged:
    """Makes runs above 500 beside the others: each has been under way for `age` seconds, and ends when it is idle.

    It ends a run of its own accord when it was told three times in a row that there is nothing to start. Every run
    takes `seconds`.
    """

    asks_again = True

    def __init__(self, age, seconds=1.0, killed=0):
        self.age, self.seconds, self.killed = age, seconds, killed

    def __call__(self, model, requests):
        under_way, told = [], 0
        for request in requests:
            told = told + 1 if request is NOT_NOW else 0
            if request is not NOT_NOW and request.inputs["E"] > 500.0:
                requests.begun[request.key] -= self.age
                under_way.append(request)
            elif request is not NOT_NOW:
                yield self.record(model, request)
            elif told > 2 and under_way:
                yield self.record(model, under_way.pop(0))
        for request in under_way:
            yield self.record(model, request)

    def record(self, model, request):
        if self.killed and request.inputs["E"] <= 500.0:
            self.killed -= 1
            return RunRecord(request.key, request.inputs, "killed", failure_kind="worker_died", message="gone")
        (record,) = InProcess()(model, [request])
        return replace(record, seconds=self.seconds)


def course(path, first, choice, executor, **options):
    """Return what was shown to the choice, and the order in which runs ended."""
    ended = []
    note = lambda record, progress: ended.append(record.inputs["E"])  # noqa: E731
    done = batches(path, Cantilever(), [design(*first)], choice, executor, on_record=note, **options)
    assert states(done) == ["ok"] * len(done), "slow runs are waited for in the end"
    return choice.shown, ended


def test_a_slow_run_holds_up_no_batch_and_is_shown_in_its_place_once_it_has_ended(path):
    choice = Choice(design(300, 350), design(450))
    shown, ended = course(path, (600, 400), choice, Aged(age=100.0), patience=3.0)
    assert ended == [400.0, 300.0, 350.0, 450.0, 600.0]
    assert shown == [[400.0], [400.0, 300.0, 350.0], [400.0, 300.0, 350.0, 450.0]]
    other = path.with_name("other.sqlite")
    shown, ended = course(other, (600, 400), Choice(design(700, 800), design(450)), Aged(age=100.0), patience=3.0)
    assert shown[1:] == [[600.0, 400.0, 700.0], [600.0, 400.0, 700.0, 450.0]]


@pytest.mark.parametrize(
    ("age", "seconds", "first", "patience", "shown"),
    [
        (3.5, 1.0, (600, 400), 3.0, (400,)),
        (2.5, 1.0, (600, 400), 3.0, (600, 400)),
        (1.5, 0.01, (600, 400), 3.0, (400,)),
        (0.5, 0.01, (600, 400), 3.0, (600, 400)),
        (100.0, 1.0, (600, 400), float("inf"), (600, 400)),
        (100.0, 1.0, (600, 700, 400), 3.0, (600, 400)),
        (100.0, 1.0, (400, 400, 400, 600, 700), 3.0, (400, 400, 400, 600)),
        (100.0, 1.0, (400, 300, 600, 700), 3.0, (400, 300)),
    ],
)
def test_a_run_is_slow_beside_half_of_its_batch_that_took_much_less_time(path, age, seconds, first, patience, shown):
    """Half of the distinct runs; where less of them are settled, one more is waited for."""
    choice = Choice(design(310))
    course(path, first, choice, Aged(age, seconds), patience=patience)
    assert choice.shown[0] == list(shown)


def test_the_longest_run_counts_even_if_an_earlier_campaign_made_it(path):
    (inputs,) = design(450)
    request = begun_before(path, Cantilever(), inputs)
    with Ledger.open(path, model=Cantilever()) as ledger:
        ledger.finished(RunRecord(request.key, inputs, "failed", seconds=1000.0, failure_kind="exception"))
    choice = Choice(design(300))
    batches(path, Cantilever(), [[inputs], design(600, 400)], choice, Aged(age=100.0), patience=3.0)
    assert choice.shown[0] == [450.0, 600.0, 400.0]


def test_a_run_is_tried_again_beside_a_slow_one(path):
    choice = Choice(design(450))
    shown, ended = course(path, (600, 400), choice, Aged(age=100.0, killed=1), patience=3.0)
    assert ended == [400.0, 400.0, 450.0, 600.0]
    assert shown == [[400.0], [400.0, 450.0]]


def test_failed_runs_are_shown_like_others_and_harm_none(path, tmp_path, executor):
    model, seen = Counted(str(tmp_path), Faulty(fault="exception", above=500.0)), []

    def choose(records):
        seen.append(states(records))
        return [design(350, 700), design(300), []][len(seen) - 1]

    done = batches(path, model, [design(400, 600)], choose, executor)
    assert seen == [["ok", "failed"], ["ok", "failed"] * 2, ["ok", "failed"] * 2 + ["ok"]]
    assert states(done) == seen[-1]
    assert sorted(calls(tmp_path).values()) == [1] * 5


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
    choice = Choice(design(350, 360), design(370))
    done = batches(path, Cantilever(), [design(300, 400)], choice, Hesitates())
    assert stiffnesses(done) == [300.0, 400.0, 350.0, 360.0, 370.0]
    assert [len(shown) for shown in choice.shown] == [2, 4, 5]


def test_the_policy_is_heeded(tmp_path, executor):
    model, choice = Moody({600.0: 2, 700.0: 2}), Choice(design(350, 700))
    retry = FailurePolicy({"failed": Retry(2)}, stop_share=2.0)
    done = batches(tmp_path / "retry.sqlite", model, [design(600, 400)], choice, executor, policy=retry)
    assert states(done) == ["ok"] * 4
    assert model.calls == {600.0: 3, 400.0: 1, 350.0: 1, 700.0: 3}
    assert choice.shown == [[600.0, 400.0], [600.0, 400.0, 350.0, 700.0]]

    model, abort, path = Moody({600.0: 1}), FailurePolicy({"failed": "abort"}), tmp_path / "abort.sqlite"
    with pytest.raises(CampaignStopped, match="no licence"):
        batches(path, model, [design(400)], Choice(design(600), design(300)), executor, policy=abort)
    assert model.calls == {400.0: 1, 600.0: 1}
    assert states(batches(path, model, [design(400), design(600)], Choice(), executor, policy=abort)) == ["ok", "ok"]

    model, mostly = Moody(dict.fromkeys([600.0, 700.0, 800.0, 900.0], 9)), FailurePolicy(stop_after=4, stop_share=0.6)
    choice, path = Choice(design(700, 800, 900)), tmp_path / "mostly.sqlite"
    with pytest.raises(CampaignStopped, match="3 of 4 runs failed"):
        batches(path, model, [design(400, 600)], choice, executor, policy=mostly)


def test_a_run_lost_with_earlier_drivers_is_given_up_and_shown(path):
    begun_before(path, Cantilever(), *design(400), times=2)
    choice = Choice(design(400))
    done = batches(path, Cantilever(), [design(300)], choice, maximum_attempts=2)
    assert [(record.state, record.failure_kind) for record in done] == [("ok", None), ("killed", "lost")]
    assert choice.shown == [[300.0], [300.0, 400.0]]


def test_an_interrupted_choice_costs_nothing_but_the_runs_under_way(path):
    def interrupted(records):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        batches(path, Cantilever(), [design(600, 400)], interrupted, Aged(age=100.0), maximum_attempts=1)
    assert counts(path) == Counts(ok=1, killed=1)
    choice = Choice(design(300))
    assert states(batches(path, Cantilever(), [design(600, 400)], choice, maximum_attempts=1)) == ["ok"] * 3
    assert choice.shown == [[600.0, 400.0], [600.0, 400.0, 300.0]]


def test_an_interruption_between_records_keeps_what_is_finished(path, executor):
    def interrupt(record, progress):
        if record.inputs["E"] == 350.0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        batches(path, Cantilever(), [design(300, 400)], Choice(design(350)), executor, on_record=interrupt)
    assert counts(path) == Counts(ok=3)
    done = batches(path, Cantilever(), [design(300, 400), design(350)], Choice(design(450)), executor)
    assert stiffnesses(done) == [300.0, 400.0, 350.0, 450.0]


@pytest.mark.parametrize("kind", [Elsewhere, ElsewhereWaits])
def test_runs_that_go_on_without_a_driver_are_collected(path, kind):
    executor, choice = kind(), Choice(design(350, 360))
    request = begun_before(path, Cantilever(), *design(300))
    executor.waiting[request.key] = request
    done = batches(path, Cantilever(), [design(300, 400)], choice, executor, maximum_attempts=1)
    assert states(done) == ["ok"] * 4
    assert executor.submitted == [400.0, 350.0, 360.0]
    assert choice.shown == [[300.0, 400.0], [300.0, 400.0, 350.0, 360.0]]


def test_a_run_that_was_killed_without_a_driver_is_started_again(path):
    executor, request = ElsewhereWaits(lost={300.0: 1}), begun_before(path, Cantilever(), *design(300))
    executor.waiting[request.key] = request
    done = batches(path, Cantilever(), [design(300, 400)], Choice(design(350)), executor)
    assert states(done) == ["ok"] * 3
    assert executor.submitted == [400.0, 300.0, 350.0]
    assert attempts(path) == [1, 1, 2]


def test_the_first_who_finds_nothing_waiting_is_told_before_anyone_chooses(path):
    """An executor may pull with a record in its hands, which the choice must not miss."""
    asked = []

    def further(starts):
        asked.append(sorted(starts.running))

    with Ledger.open(path, model="any") as ledger:
        starts = Starts(ledger, [RunRequest("first", {"E": 300.0})], set(), further)
        assert next(starts).key == "first"
        assert next(starts) is NOT_NOW
        assert asked == []
        assert list(starts) == []
        assert asked == [["first"]]


def test_a_run_is_under_way_since_its_present_attempt(path):
    again = RunRequest("again", {"E": 300.0})
    with Ledger.open(path, model="any") as ledger:
        starts = Starts(ledger, [again], set(), lambda starts: ())
        next(starts)
        starts.begun["again"] -= 100.0
        first = starts.begun["again"]
        starts.put_back(again)
        next(starts)
        assert starts.begun["again"] > first + 99.0


@pytest.mark.parametrize("first", [[], [[]], [design(300), []]], ids=str)
def test_there_must_be_a_first_batch(path, first):
    with pytest.raises(InvalidInput, match="batches to begin with"):
        batches(path, Cantilever(), first, Choice())


def test_what_makes_no_campaign_is_refused(path):
    for patience in (0.0, -1.0, float("nan")):
        with pytest.raises(InvalidInput, match="patience"):
            batches(path, Cantilever(), [design(300)], Choice(), patience=patience)
    listed = iter([design(350)])
    with pytest.raises(InvalidInput, match="give `next` a default"):
        batches(path, Cantilever(), [design(300)], lambda records: next(listed))
    assert counts(path) == Counts(ok=2), "no silent end"
    with Ledger.open(path.with_name("other.sqlite"), model="other") as ledger, pytest.raises(LedgerError):
        run_batches(Cantilever(), [design(300)], Choice(), ledger=ledger, executor=InProcess())
