"""Campaigns: what is run and what is not, what becomes of runs that fail or are lost, and executors that err."""

from contextlib import nullcontext
from dataclasses import replace
from operator import length_hint
from pathlib import Path

import pytest
from tests.unit.runs import fakes
from tests.unit.runs.fakes import Elsewhere, Moody, Noted, Seen, Served, begun_before, campaign, counts, design, states

from strandline.foundations import CampaignStopped, ForwardModelError, InvalidInput, LedgerError, NumericsError
from strandline.models import fingerprint
from strandline.runs import (
    Counts,
    FailurePolicy,
    InProcess,
    Ledger,
    PlainBatch,
    Progress,
    Retry,
    RunRecord,
    attempt,
    run_batches,
    run_campaign,
)
from strandline.runs.campaign import Starts
from strandline.runs.failures import IN_A_ROW, Outages
from strandline.runs.ledger.ledger_schema import INTERRUPTED
from strandline.testing.executors import same_outcome
from strandline.testing.models import Cantilever, Counted, Faulty, TwoLoads

BEAM = Cantilever()


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

    def peeking(model, requests):
        for request in requests:
            seen.append(counts(path).open)
            yield from InProcess()(model, [request])

    campaign(path, BEAM, design(300, 400, 500), peeking)
    assert seen == [1, 1, 1]


def test_runs_without_sensitivities_are_made_again_where_they_are_asked_for(path):
    plain, asked, inputs = TwoLoads(), TwoLoads(sensitivities=True), design(300, 400, -1)
    first = campaign(path, plain, inputs)
    executor, idle = Noted(), Noted()
    second = campaign(path, asked, [*inputs, *design(500)], executor)
    assert executor.calls == [[300.0, 400.0, 500.0]]
    assert [list(record.sensitivities) for record in second] == [["light", "heavy"]] * 2 + [[]] + [["light", "heavy"]]
    for one, other in zip(first, second, strict=False):
        for condition, interface in one.interfaces.items():
            assert other.interfaces[condition].points.tobytes() == interface.points.tobytes()
    assert alike(second, campaign(path, asked, [*inputs, *design(500)], idle))
    assert alike(campaign(path, plain, inputs, idle), second, strict=False), "the newer outcome counts"
    assert idle.calls == []
    assert fakes.repeated(path) == 2


def test_a_plain_batch_is_run_without_sensitivities_and_settles(path):
    asked, inputs = TwoLoads(sensitivities=True), design(300, 400)
    common = {"executor": InProcess(), "policy": FailurePolicy()}

    def further(records):
        return PlainBatch(design(500)) if len(records) == 2 else []

    with Ledger.open(path, model=fingerprint(asked)) as ledger:
        made = run_batches(asked, [inputs], further, ledger=ledger, **common)
        assert [list(record.sensitivities["light"]) for record in made] == [["E", "load"], ["E", "load"], []]
        assert [record.settles(sensitivities=True) for record in made] == [True] * 3
    idle = Noted()
    assert alike(made, campaign(path, asked, [*inputs, *design(500)], idle))
    assert idle.calls == []


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


def test_a_run_lost_with_its_driver_or_killed_too_often_is_given_up_and_says_so(path):
    """A simulator that takes an in-process driver down would otherwise do so for ever."""
    begun_before(path, BEAM, *design(400), times=2)
    (given_up,) = campaign(path, BEAM, design(400), maximum_attempts=2)
    assert (given_up.state, given_up.failure_kind) == ("killed", "lost")
    assert "given up after 2 attempts" in given_up.message
    made = Seen()
    (killed,) = campaign(path, BEAM, design(300), dying, maximum_attempts=2, on_record=made)
    assert (killed.state, killed.failure_kind, len(made)) == ("killed", "worker_died", 2)
    (again,) = campaign(path, BEAM, design(300), Noted(), maximum_attempts=2)
    assert again.message.startswith("gone\ngiven up after 2 attempts")
    assert "raise maximum_attempts" in again.message
    assert states(campaign(path, BEAM, design(300, 400), maximum_attempts=3)) == ["ok", "ok"]


def interrupt(*_):
    raise KeyboardInterrupt


def test_an_interruption_keeps_what_is_finished_and_costs_no_attempt(path, tmp_path):
    model, inputs = Counted(str(tmp_path)), design(300, 400, 500, 600)

    def interrupted(inputs, workdir):
        raise KeyboardInterrupt

    interrupted.fingerprint = model.fingerprint
    with pytest.raises(KeyboardInterrupt):
        campaign(path, model, inputs, on_record=interrupt, maximum_attempts=1)
    assert counts(path) == Counts(ok=1)
    with pytest.raises(KeyboardInterrupt):
        campaign(path, interrupted, inputs, maximum_attempts=1)
    assert counts(path) == Counts(ok=1, killed=1)
    assert states(campaign(path, model, inputs, maximum_attempts=1)) == ["ok"] * 4
    assert max(fakes.calls(tmp_path).values()) == 1


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
        (answering(lambda record: [record.interface]), InvalidInput, "got a Interface; expected a RunRecord"),
        (answering(lambda record: [record, record]), InvalidInput, "one record for each"),
        (answering(lambda record: [replace(record, key="another")]), InvalidInput, "a record of the run another"),
    ],
)
def test_an_executor_that_answers_wrongly_is_named(path, executor, error, said):
    with pytest.raises(error, match=said):
        campaign(path, BEAM, design(400, 500), executor)


def test_an_executor_that_forgets_a_run_has_it_tried_again_and_given_up(path):
    def forgetful(model, requests):
        list(requests)
        return iter(())

    (record,) = campaign(path, BEAM, design(300), forgetful, maximum_attempts=3)
    assert (record.state, record.failure_kind) == ("killed", "lost")


def test_what_a_campaign_cannot_do_is_refused(path):
    with Ledger.open(path, model="other") as ledger, pytest.raises(LedgerError, match="another model"):
        run_campaign(BEAM, design(300), ledger=ledger, executor=InProcess())
    with pytest.raises(InvalidInput, match="maximum_attempts"):
        campaign(path.with_name("new.sqlite"), BEAM, design(300), maximum_attempts=0)


def test_runs_that_go_on_without_a_driver_stay_open_and_the_next_driver_collects_them(path):
    executor, inputs = Elsewhere(), design(300, 400, 500, 600)
    for made in (1, 2, 3):
        with pytest.raises(KeyboardInterrupt):
            campaign(path, BEAM, inputs, executor, on_record=interrupt, maximum_attempts=1)
        assert counts(path) == Counts(ok=made, open=4 - made)
    assert states(campaign(path, BEAM, inputs, executor, maximum_attempts=1)) == ["ok"] * 4
    assert executor.submitted == [300.0, 400.0, 500.0, 600.0]
    assert fakes.attempts(path) == [1, 1, 1, 1]


def test_a_run_killed_elsewhere_is_submitted_again_and_one_that_is_not_known_there_any_more_is_started_again(path):
    executor = Elsewhere(lost={300.0: 2, 400.0: 3})
    done, given_up = campaign(path, BEAM, design(300, 400), executor)
    assert done.ok
    assert (given_up.state, given_up.failure_kind) == ("killed", "node_failed")
    assert sorted(executor.submitted) == [300.0] * 3 + [400.0] * 3
    assert fakes.attempts(path) == [3, 3]
    with pytest.raises(KeyboardInterrupt):
        campaign(path, BEAM, design(500, 600), executor, on_record=interrupt)
    executor.waiting.clear()
    assert states(campaign(path, BEAM, design(500, 600), executor)) == ["ok", "ok"]
    assert fakes.attempts(path) == [1, 2, 3, 3]


MANY = [300.0 + i for i in range(26)]


def test_failed_runs_are_tried_again_as_often_as_the_policy_says(path):
    model, retry = Moody({400.0: 1, 500.0: 2, 600.0: 3}), FailurePolicy({"licence": Retry(2)})
    for _ in range(2):
        done = campaign(path, model, design(300, 400, 500, 600), policy=retry)
        assert states(done) == ["ok", "ok", "ok", "failed"]
        assert model.calls == {300.0: 1, 400.0: 2, 500.0: 3, 600.0: 3}


def test_an_action_for_a_state_serves_its_kinds_and_one_for_the_kind_goes_before():
    failed = RunRecord("key", {"E": 1.0}, "failed", failure_kind="licence", message="reason")
    killed = RunRecord("key", {"E": 1.0}, "killed", failure_kind="worker_died", message="reason")
    assert FailurePolicy({"failed": Retry(4)}).attempts(failed, killed=3) == 5
    assert FailurePolicy({"failed": Retry(4), "licence": "continue"}).attempts(failed, killed=3) == 1
    assert FailurePolicy().attempts(killed, killed=3) == 3
    assert FailurePolicy({"killed": "continue"}).attempts(killed, killed=3) == 1
    assert FailurePolicy({"failed": "abort"}).aborts(failed)
    assert not FailurePolicy({"failed": "abort", "licence": "continue"}).aborts(failed)


def test_abort_ends_the_campaign_keeps_what_is_done_and_tries_that_run_first_when_started_again(path):
    model, policy = Moody({400.0: 1}), FailurePolicy({"licence": "abort"})
    with pytest.raises(CampaignStopped, match=r"licence.*\n.*E = 400.*no licence(.|\n)*server busy(.|\n)*tried again"):
        campaign(path, model, design(300, 400, 500), policy=policy)
    assert model.calls == {300.0: 1, 400.0: 1}
    assert states(campaign(path, model, design(300, 400, 500), policy=policy)) == ["ok"] * 3
    assert model.calls == {300.0: 1, 400.0: 2, 500.0: 1}


def test_failures_asked_for_again_are_run_once_more_with_all_their_retries_and_no_others(path):
    model, inputs = Moody({400.0: 1, 500.0: 9}), design(300, 400, 500)
    campaign(path, model, inputs)
    again = campaign(path, model, inputs, policy=FailurePolicy(again=frozenset({"licence"})))
    assert states(again) == ["ok", "ok", "failed"]
    campaign(path, model, inputs, policy=FailurePolicy(again=frozenset({"timeout"})))
    assert model.calls == {300.0: 1, 400.0: 2, 500.0: 2}
    policy = FailurePolicy({"licence": Retry()}, again=frozenset({"failed"}))
    campaign(path, model, inputs[2:], policy=policy)
    assert model.calls[500.0] == 4


def test_a_campaign_most_of_whose_runs_fail_stops_early_and_says_why(path):
    some = [value for value in MANY if value % 4]
    for failing, options, said, made in (
        (MANY, {}, r"20 of 20 runs failed \(20 × licence\)(.|\n)*server busy", 20),
        (some, {"stop_after": 12, "stop_share": 0.7}, "9 of 12 runs failed(.|\n)*move ledger.sqlite away, then", 12),
    ):
        model = Moody(dict.fromkeys(failing, 1))
        with pytest.raises(CampaignStopped, match=said):
            campaign(path.with_name(f"{made}.sqlite"), model, design(*MANY), policy=FailurePolicy(**options))
        assert sum(model.calls.values()) == made


def test_a_mistake_in_the_models_code_stops_it_after_five_runs_and_no_other_error_does(path):
    for number, (error, made) in enumerate(
        ((NameError("name 'h'"), 5), (ValueError("no root"), 20), (ForwardModelError("NameError", "h"), 20))
    ):
        model = Moody(dict.fromkeys(MANY, 1), error)
        with pytest.raises(CampaignStopped, match=rf"{made} of {made} runs .*(.|\n)*`strandline retry STUDY --kind "):
            campaign(path.with_name(f"{number}.sqlite"), model, design(*MANY), policy=FailurePolicy())
    wrong = Moody(dict.fromkeys(MANY, 1), NameError("name 'h'"))
    assert len(campaign(path, wrong, design(*MANY[:9]), policy=FailurePolicy(stop_share=2.0))) == 9


def test_failures_are_borne_where_they_are_of_an_earlier_campaign_or_the_policy_says_so(path):
    model = Moody(dict.fromkeys(MANY[:19], 1))
    campaign(path, model, design(*MANY[:19]))
    assert len(campaign(path, model, design(*MANY[:21]), policy=FailurePolicy())) == 21
    failing, other = Moody(dict.fromkeys(MANY, 1)), path.with_name("other.sqlite")
    assert len(campaign(other, failing, design(*MANY[:21]), policy=FailurePolicy(stop_share=2.0))) == 21


def test_what_makes_no_policy_is_refused():
    for wrong in ({"actions": {"timeout": "recover"}}, {"stop_after": 0}, {"stop_share": 0.0}):
        with pytest.raises(InvalidInput):
            FailurePolicy(**wrong)
    with pytest.raises(InvalidInput, match="at least 1"):
        Retry(0)


def abreast(model, requests):
    """Have two runs under way, and tell how the second one ended."""
    for request in list(requests)[1:2]:
        yield attempt(model, request, Path())


def test_abort_leaves_a_run_beside_it_to_be_made_without_an_attempt_less(path):
    model, policy = Moody({400.0: 4}), FailurePolicy({"licence": "abort", "killed": "continue"})
    options = {"maximum_attempts": 1, "policy": policy}
    for _ in range(4):
        with pytest.raises(CampaignStopped):
            campaign(path, model, design(300, 400), abreast, **options)
        with Ledger.open(path, model=None, read_only=True) as ledger:
            beside, _ = ledger
            assert (beside.inputs["E"], beside.state, beside.failure_kind) == (300.0, "killed", INTERRUPTED)
            assert "it will be run again" in beside.message
            assert ledger.attempts(beside.key) == 0
    assert states(campaign(path, model, design(300, 400), **options)) == ["ok", "ok"]
    assert model.calls == {300.0: 1, 400.0: 5}


def test_a_server_that_goes_down_is_waited_for_and_costs_no_run(path):
    model, seen = Served(runs=5, probes=0), Seen()
    assert states(campaign(path, model, design(*MANY), on_record=seen)) == ["ok"] * len(MANY)
    assert (model.lost, max(fakes.attempts(path))) == (IN_A_ROW, 2)
    assert [progress.waiting for _, progress in seen].count(True) == 1


def test_a_server_that_stays_away_stops_the_campaign_and_no_start_of_it_uses_up_runs(path):
    model = Served(runs=0, probes=1000)
    for _ in range(4):
        with pytest.raises(CampaignStopped, match=r"server: no server\n.*not lost"):
            campaign(path, model, design(*MANY))
        assert model.lost == IN_A_ROW
    model.probes = 0
    assert states(campaign(path, model, design(*MANY))) == ["ok"] * len(MANY)


def test_a_server_that_has_made_a_run_is_waited_for_ten_minutes():
    lost = RunRecord("key", {}, "killed", failure_kind="connection")
    for probes, seconds, end in ((3, 15, nullcontext()), (1000, 600, pytest.raises(CampaignStopped))):
        waits = []
        server = Outages(Served(runs=0, probes=probes), waits.append)
        server.note(RunRecord("key", {}, "ok"))
        with end:
            server.require_server([lost])
        assert sum(waits) == seconds


@pytest.mark.stand_in
def test_executors_start_no_more_workers_than_the_model_allows_runs(path):
    hints = []

    def hinted(model, requests):
        hints.append(length_hint(requests, 7))
        return InProcess()(model, requests)

    campaign(path, Served(runs=100, probes=0), design(300, 400), hinted)
    for further, at_once in ((None, None), (None, 2), (None, 9), (list, None), (list, 2)):
        hints.append(length_hint(Starts(None, range(3), set(), further, at_once), 7))
    assert hints == [1, 3, 2, 3, 7, 2]
