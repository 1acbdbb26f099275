"""Campaigns: what is run and what is not, what becomes of runs that fail or are lost, and executors that err."""

from dataclasses import replace

import pytest
from tests.unit.runs import fakes
from tests.unit.runs.fakes import Elsewhere, Noted, Seen, begun_before, campaign, counts, design, states

from strandline.errors import InvalidInput, LedgerError, NumericsError
from strandline.runs import Counts, InProcess, Ledger, Progress, RunRecord, run_campaign
from strandline.testing.executors import same_outcome
from strandline.testing.models import Cantilever, Counted, Faulty, TwoLoads


def alike(first, second, *, strict=True):
    return all(same_outcome(*pair) for pair in zip(first, second, strict=strict))


def test_only_what_is_missing_is_run_and_equal_inputs_once(path, tmp_path):
    model, seen = Counted(str(tmp_path)), Seen()
    first = campaign(path, model, design(300, 400, 300, 300))
    assert fakes.stiffnesses(first) == [300.0, 400.0, 300.0, 300.0]
    assert first[0] is first[2] is first[3]
    second = campaign(path, model, design(300, 500, 400), on_record=seen)
    assert sorted(fakes.calls(tmp_path).values()) == [1, 1, 1]
    assert alike(first[:2], [second[0], second[2]])
    ((record, progress),) = seen
    assert record.inputs["E"] == 500.0
    assert progress == Progress(3, 3, 3, 0, 2, progress.elapsed)


def test_failures_are_data_and_final(path):
    model, seen, inputs = Faulty(fault="exception", above=450.0), Seen(), design(400, 500, -1)
    done = campaign(path, model, inputs, on_record=seen)
    assert states(done) == ["ok", "failed", "failed"]
    assert [record.failure_kind for record in done] == [None, "exception", "nonpositive_stiffness"]
    assert [(p.total, p.finished, p.ok, p.failed) for _, p in seen] == [(3, 1, 1, 0), (3, 2, 1, 1), (3, 3, 1, 2)]
    assert seen[0][1].remaining_seconds == pytest.approx(2 * seen[0][1].elapsed)
    assert Progress(3, 1, 1, 0, 1, 5.0).remaining_seconds is None
    again = campaign(path, model, inputs, on_record=lambda *_: pytest.fail("nothing was missing"))
    assert alike(done, again)


def test_each_run_is_started_in_the_ledger_before_it_runs(path):
    seen = []
    with Ledger.open(path, model=Cantilever()) as ledger:

        def peeking(model, requests):
            for request in requests:
                seen.append(ledger.counts().open)
                yield from InProcess()(model, [request])

        run_campaign(Cantilever(), design(300, 400, 500), ledger=ledger, executor=peeking)
    assert seen == [1, 1, 1]


def test_runs_without_sensitivities_are_made_again_where_they_are_asked_for(path):
    plain, asked, inputs = TwoLoads(), TwoLoads(sensitivities=True), design(300, 400, -1)
    first = campaign(path, plain, inputs)
    executor, idle = Noted(), Noted()
    second = campaign(path, asked, [*inputs, *design(500)], executor)
    assert executor.made == [300.0, 400.0, 500.0]
    assert [list(record.sensitivities) for record in second] == [["light", "heavy"]] * 2 + [[]] + [["light", "heavy"]]
    for one, other in zip(first, second, strict=False):
        for condition, interface in one.interfaces.items():
            assert other.interfaces[condition].points.tobytes() == interface.points.tobytes()
    assert alike(second, campaign(path, asked, [*inputs, *design(500)], idle))
    assert alike(campaign(path, plain, inputs, idle), second, strict=False), "the newer outcome counts"
    assert idle.made == []
    assert fakes.repeated(path) == 2


def dying(model, requests):
    for request in requests:
        yield RunRecord(request.key, request.inputs, "killed", failure_kind="worker_died", message="gone")


def test_a_run_that_ends_badly_only_with_its_sensitivities_is_given_up(path):
    (first,) = campaign(path, TwoLoads(), design(300))
    (record,) = campaign(path, TwoLoads(sensitivities=True), design(300), dying)
    assert (record.state, record.failure_kind) == ("killed", "worker_died")
    with Ledger.open(path, model=None, read_only=True) as ledger:
        assert (ledger.attempts(first.key), ledger.open_attempts(first.key)) == (4, 3)
    (second,) = campaign(path, TwoLoads(), design(400))
    begun_before(path, TwoLoads(), *design(400), times=3)
    (kept,) = campaign(path, TwoLoads(sensitivities=True), design(400), Noted())
    assert same_outcome(kept, second), "it was lost, and keeps its interface"


def test_only_runs_with_sensitivities_are_copied_where_they_are_asked_for(path, tmp_path):
    inputs, other = design(300, 400, -1), tmp_path / "other.sqlite"
    (steep,) = campaign(other, TwoLoads(sensitivities=True), inputs[:1])
    campaign(other, TwoLoads(), inputs)
    keys = [fakes.key_of(TwoLoads(), entry) for entry in inputs]
    campaign(path, TwoLoads(), inputs[:1])
    with Ledger.open(path, model=TwoLoads()) as ledger:
        assert ledger.copy_from(other, keys, sensitivities=True) == 2
        found = ledger.latest(keys)
        assert [key in found for key in keys] == [True, False, True]
        assert same_outcome(found[keys[0]], steep)
        assert ledger.copy_from(other, keys) == 1


def test_a_run_lost_with_its_driver_too_often_is_given_up(path):
    """A simulator that takes an in-process driver down would otherwise do so for ever."""
    begun_before(path, Cantilever(), *design(400), times=2)
    (given_up,) = campaign(path, Cantilever(), design(400), maximum_attempts=2)
    assert (given_up.state, given_up.failure_kind) == ("killed", "lost")
    assert "given up after 2 attempts" in given_up.message
    (done,) = campaign(path, Cantilever(), design(400), maximum_attempts=3)
    assert done.ok


def test_a_run_that_was_killed_too_often_is_given_up_and_says_so(path):
    made = Seen()
    (killed,) = campaign(path, Cantilever(), design(300), dying, maximum_attempts=2, on_record=made)
    assert (killed.state, killed.failure_kind, len(made)) == ("killed", "worker_died", 2)
    (again,) = campaign(path, Cantilever(), design(300), Noted(), maximum_attempts=2)
    assert again.message.startswith("gone\ngiven up after 2 attempts")
    assert "raise maximum_attempts" in again.message
    (done,) = campaign(path, Cantilever(), design(300), maximum_attempts=3)
    assert done.ok


def test_an_interruption_keeps_what_is_finished_and_costs_no_attempt(path, tmp_path):
    model, inputs = Counted(str(tmp_path)), design(300, 400, 500, 600)

    def stop_after_two(record, progress):
        if progress.finished == 2:
            raise KeyboardInterrupt

    def interrupted(inputs, workdir):
        raise KeyboardInterrupt

    interrupted.fingerprint = model.fingerprint
    with pytest.raises(KeyboardInterrupt):
        campaign(path, model, inputs, on_record=stop_after_two, maximum_attempts=1)
    assert counts(path) == Counts(ok=2)
    with pytest.raises(KeyboardInterrupt):
        campaign(path, interrupted, inputs, maximum_attempts=1)
    assert counts(path) == Counts(ok=2, killed=1)
    assert states(campaign(path, model, inputs, maximum_attempts=1)) == ["ok"] * 4
    assert max(fakes.calls(tmp_path).values()) == 1


class Forgetful(Ledger):
    """A planted bug: a ledger that does not find what it holds."""

    def latest(self, keys):
        return {}


def test_the_count_of_repeated_runs_sees_a_forgetful_ledger(path):
    for _ in range(2):
        with Forgetful.open(path, model=Cantilever()) as ledger:
            run_campaign(Cantilever(), design(300, 400), ledger=ledger, executor=InProcess())
    assert fakes.repeated(path) == 2


def answering(answer):
    """Return an executor that answers each request with what `answer` makes of its record."""

    def execute(model, requests):
        for record in InProcess()(model, requests):
            yield from answer(record)

    return execute


@pytest.mark.parametrize(
    ("executor", "error", "said"),
    [
        (lambda model, requests: iter(()), NumericsError, "without starting"),
        (lambda model, requests: None, InvalidInput, "function yields: got a NoneType; expected records"),
        (answering(lambda record: [record.interface]), InvalidInput, "got a Interface; expected a RunRecord"),
        (answering(lambda record: [record, record]), InvalidInput, "one record for each"),
        (answering(lambda record: [replace(record, key="another")]), InvalidInput, "a record of the run another"),
    ],
)
def test_an_executor_that_answers_wrongly_is_named(path, executor, error, said):
    with pytest.raises(error, match=said):
        campaign(path, Cantilever(), design(400, 500), executor)


def test_an_executor_that_forgets_a_run_has_it_tried_again_and_given_up(path):
    def forgetful(model, requests):
        list(requests)
        return iter(())

    (record,) = campaign(path, Cantilever(), design(300), forgetful, maximum_attempts=3)
    assert (record.state, record.failure_kind) == ("killed", "lost")


def test_what_a_campaign_cannot_do_is_refused(path):
    with Ledger.open(path, model="other") as ledger, pytest.raises(LedgerError, match="another model"):
        run_campaign(Cantilever(), design(300), ledger=ledger, executor=InProcess())
    with pytest.raises(InvalidInput, match="maximum_attempts"):
        campaign(path.with_name("new.sqlite"), Cantilever(), design(300), maximum_attempts=0)


def interrupted_after_one(path, executor, inputs, **options):
    def interrupt(record, progress):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        campaign(path, Cantilever(), inputs, executor, on_record=interrupt, **options)


def test_runs_that_go_on_without_a_driver_stay_open_and_the_next_driver_collects_them(path):
    executor, inputs = Elsewhere(), design(300, 400, 500, 600)
    for made in (1, 2, 3):
        interrupted_after_one(path, executor, inputs, maximum_attempts=1)
        assert counts(path) == Counts(ok=made, open=4 - made)
    with Ledger.open(path, model=None, read_only=True) as ledger:
        done = [record.key for record in ledger]
        (waiting,) = executor.waiting.keys() - done
        assert ledger.open_runs([*done, waiting, "unknown"]) == {waiting}
        assert ledger.open_runs(done) == frozenset()
    assert states(campaign(path, Cantilever(), inputs, executor, maximum_attempts=1)) == ["ok"] * 4
    assert executor.submitted == [300.0, 400.0, 500.0, 600.0]
    assert fakes.attempts(path) == [1, 1, 1, 1]


def test_a_run_that_was_killed_elsewhere_is_submitted_again_and_each_time_counts(path):
    executor = Elsewhere(lost={300.0: 2, 400.0: 3})
    done, given_up = campaign(path, Cantilever(), design(300, 400), executor)
    assert done.ok
    assert (given_up.state, given_up.failure_kind) == ("killed", "node_failed")
    assert sorted(executor.submitted) == [300.0] * 3 + [400.0] * 3
    assert fakes.attempts(path) == [3, 3]


def test_what_the_executor_does_not_know_any_more_is_started_again(path):
    executor, inputs = Elsewhere(), design(300, 400)
    interrupted_after_one(path, executor, inputs)
    executor.waiting.clear()
    assert states(campaign(path, Cantilever(), inputs, executor)) == ["ok", "ok"]
    assert fakes.attempts(path) == [1, 2]
