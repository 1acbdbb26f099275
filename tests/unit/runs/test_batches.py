"""Campaigns in batches: what a choice is made from and when, slow runs, resumption."""

from dataclasses import replace
from pathlib import Path

import pytest
from tests.unit.runs import fakes
from tests.unit.runs.fakes import Noted, Seen, batches, begun_before, design, states, stiffnesses

from strandline.foundations import InvalidInput
from strandline.runs import NOT_NOW, Counts, InProcess, RunRecord
from strandline.testing.models import Cantilever, Counted

BEAM = Cantilever()


class Choice:
    """Gives the listed batches, then an empty one; notes what it was shown."""

    def __init__(self, *listed):
        self.left, self.shown = list(listed), []

    def __call__(self, records):
        self.shown.append(stiffnesses(records))
        return self.left.pop(0) if self.left else []


@pytest.fixture(params=[True, False], ids=["waits", "a call for each batch"])
def executor(request):
    return Noted(waits=request.param)


def follows(records):
    """Return two runs that depend on the bits of all interfaces and on their order, until there are eight."""
    number = 0.0
    for record in records:
        number = (0.37 * number + 1e7 * record.interface.points[:, 1].max() ** 2) % 100.0
    return design(300.0 + number, 450.0 - number / 3) if len(records) < 8 else []


def test_each_batch_follows_from_all_records_in_the_order_of_the_design(path, executor):
    shown, first, direct = [], design(400, 300, 350), []

    def choose(records):
        shown.append(stiffnesses(records))
        return follows(records)

    done, chosen = batches(path, BEAM, [first], choose, executor), first
    while chosen:  # by calls of the model itself
        direct += [RunRecord("", inputs, "ok", BEAM(inputs, Path()).interfaces) for inputs in chosen]
        chosen = follows(direct)
    assert len(set(stiffnesses(direct))) == len(done) == 9
    assert shown == [stiffnesses(direct[:number]) for number in (3, 5, 7, 9)]
    for one, other in zip(done, direct, strict=True):
        assert dict(one.inputs) == other.inputs
        assert one.interface.points.tobytes() == other.interface.points.tobytes()


def test_batches_chosen_before_are_run_first_and_nothing_that_is_known_is_made_again(path, tmp_path, executor):
    """Only an executor that cannot wait is called for each batch."""
    model, choice, seen = Counted(str(tmp_path)), Choice(design(500, 300), design(500)), Seen()
    done = batches(path, model, [design(400, 300), design(350, 350)], choice, executor, on_record=seen)
    assert stiffnesses(done) == [400.0, 300.0, 350.0, 350.0, 500.0, 300.0, 500.0]
    assert choice.shown == [stiffnesses(done)[:number] for number in (4, 6, 7)]
    first, last = [400.0, 300.0, 350.0], [500.0]
    assert executor.calls == ([first + last] if executor.asks_again else [first, last])
    assert [(told.total, told.finished) for _, told in seen] == [(3, 1), (3, 2), (3, 3), (4, 4)]
    assert done[2] is done[3]
    choice = Choice(design(300), design(450))
    assert stiffnesses(batches(path, model, [design(350)], choice, executor)) == [350.0, 300.0, 450.0]
    assert sorted(fakes.calls(tmp_path).values()) == [1] * 5
    calls = list(executor.calls)
    assert batches(path, model, [design(400)], Choice(design(300)), executor)
    assert executor.calls == calls, "there was nothing to run"


class Aged:
    """Makes runs above 500 beside the others: each has been under way for `age` seconds.

    It ends one of them when it was told three times in a row that there is nothing to start. Every run takes `seconds`.
    """

    asks_again = True

    def __init__(self, age=100.0, seconds=1.0):
        self.age, self.seconds = age, seconds

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
        (record,) = InProcess()(model, [request])
        return replace(record, seconds=self.seconds)


def test_batches_are_made_beside_a_slow_run_that_is_waited_for_in_the_end(path):
    choice, seen = Choice(design(300, 350), design(450)), Seen()
    done = batches(path, BEAM, [design(600, 400)], choice, Aged(), on_record=seen, patience=3.0)
    assert seen.stiffnesses == [400.0, 300.0, 350.0, 450.0, 600.0]
    assert all(record.ok for record in done)
    assert choice.shown == [stiffnesses(done)[1 : number + 1] for number in (1, 3, 4)]


def test_a_slow_run_that_has_ended_is_shown_in_its_place(path):
    choice = Choice(design(700, 800), design(450))
    batches(path, BEAM, [design(600, 400)], choice, Aged(), patience=3.0)
    assert choice.shown == [[400.0], [600.0, 400.0, 700.0], [600.0, 400.0, 700.0, 450.0]]


def test_a_run_is_slow_beside_half_of_its_batch_that_took_much_less_time(path):
    """Half of the distinct runs; where less of them are settled, one more is waited for."""
    for number, (age, seconds, first, patience, shown) in enumerate(
        [
            (3.5, 1.0, (600, 400), 3.0, [400.0]),
            (2.5, 1.0, (600, 400), 3.0, [600.0, 400.0]),
            (0.5, 0.01, (600, 400), 3.0, [600.0, 400.0]),
            (100.0, 1.0, (600, 400), float("inf"), [600.0, 400.0]),
            (100.0, 1.0, (600, 700, 400), 3.0, [600.0, 400.0]),
            (100.0, 1.0, (400, 400, 400, 600, 700), 3.0, [400.0, 400.0, 400.0, 600.0]),
            (100.0, 1.0, (400, 300, 600, 700), 3.0, [400.0, 300.0]),
        ]
    ):
        choice, place = Choice(design(310)), path.with_name(f"{number}.sqlite")
        batches(place, BEAM, [design(*first)], choice, Aged(age, seconds), patience=patience)
        assert choice.shown[0] == shown


def test_a_run_lost_with_earlier_drivers_is_given_up_and_shown(path):
    begun_before(path, BEAM, *design(400), times=2)
    choice = Choice(design(400))
    done = batches(path, BEAM, [design(300)], choice, maximum_attempts=2)
    assert [(record.state, record.failure_kind) for record in done] == [("ok", None), ("killed", "lost")]
    assert choice.shown == [[300.0], [300.0, 400.0]]


def test_what_makes_no_campaign_is_refused(path):
    for first, patience, said in (
        ([], 3.0, "batches to begin with"),
        ([design(300), []], 3.0, "batches to begin with"),
        ([design(300)], float("nan"), "patience"),
    ):
        with pytest.raises(InvalidInput, match=said):
            batches(path, BEAM, first, Choice(), patience=patience)
    listed = iter([design(350)])
    with pytest.raises(InvalidInput, match="give `next` a default"):
        batches(path, BEAM, [design(300)], lambda records: next(listed))
    assert fakes.counts(path) == Counts(ok=2), "no silent end"


def test_an_interrupted_choice_costs_nothing_but_the_runs_under_way(path):
    def interrupted(records):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        batches(path, BEAM, [design(600, 400)], interrupted, Aged(), maximum_attempts=1)
    assert fakes.counts(path) == Counts(ok=1, killed=1)
    choice = Choice(design(300))
    assert states(batches(path, BEAM, [design(600, 400)], choice, maximum_attempts=1)) == ["ok"] * 3
    assert choice.shown == [[600.0, 400.0], [600.0, 400.0, 300.0]]
