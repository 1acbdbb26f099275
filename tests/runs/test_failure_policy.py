"""What a campaign does about runs that fail: nothing, another try, or an end of it all."""

from collections import Counter
from pathlib import Path

import pytest

from strandline.errors import CampaignStopped, ForwardModelError, InvalidInput
from strandline.runs import FailurePolicy, InProcess, Ledger, Retry, attempt, run_campaign
from strandline.runs.failures import require_kinds
from strandline.runs.ledger import INTERRUPTED
from strandline.testing.models import Cantilever


class Moody:
    """Fails a given number of times at a stiffness before it succeeds there; counts its calls."""

    fingerprint = "moody"

    def __init__(self, moods, kind="licence"):
        self.moods, self.kind, self.calls = dict(moods), kind, Counter()

    def __call__(self, inputs, workdir):
        stiffness = inputs["E"]
        self.calls[stiffness] += 1
        if self.calls[stiffness] <= self.moods.get(stiffness, 0):
            raise ForwardModelError(self.kind, "no licence to be had\nserver busy")
        return Cantilever()(inputs, workdir)


def design(*stiffness):
    return [{"E": float(value), "load": 1e-5} for value in stiffness]


def campaign(path, model, inputs, policy=None):
    with Ledger.open(path, model=model) as ledger:
        return run_campaign(model, inputs, ledger=ledger, executor=InProcess(), policy=policy)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "ledger.sqlite"


def test_by_default_a_failed_run_is_left_out_and_not_tried_again(path):
    model = Moody({400.0: 9})
    states = [record.state for record in campaign(path, model, design(300, 400, 500))]
    assert states == ["ok", "failed", "ok"]
    campaign(path, model, design(300, 400, 500))
    assert model.calls == {300.0: 1, 400.0: 1, 500.0: 1}


@pytest.mark.parametrize(("failures", "state", "calls"), [(1, "ok", 2), (2, "ok", 3), (3, "failed", 3)])
def test_retry_tries_again_as_often_as_it_says(path, failures, state, calls):
    model = Moody({400.0: failures})
    records = campaign(path, model, design(300, 400), FailurePolicy({"licence": Retry(2)}))
    assert [record.state for record in records] == ["ok", state]
    assert model.calls == {300.0: 1, 400.0: calls}
    assert campaign(path, model, design(400), FailurePolicy({"licence": Retry(2)}))[0].state == state
    assert model.calls[400.0] == calls


def test_an_action_for_a_state_serves_its_kinds_and_one_for_the_kind_goes_before(path):
    assert FailurePolicy({"failed": Retry(4)}).attempts(failed("licence"), killed=3) == 5
    assert FailurePolicy({"failed": Retry(4), "licence": "continue"}).attempts(failed("licence"), killed=3) == 1
    assert FailurePolicy({"failed": "abort"}).aborts(failed("licence"))
    assert not FailurePolicy({"failed": "abort", "licence": "continue"}).aborts(failed("licence"))


def failed(kind):
    from strandline.runs import RunRecord

    return RunRecord("key", {"E": 1.0}, "failed", failure_kind=kind, message="reason")


def test_abort_ends_the_campaign_keeps_what_is_done_and_tries_that_run_first_when_started_again(path):
    model, policy = Moody({400.0: 1}), FailurePolicy({"licence": "abort"})
    with pytest.raises(CampaignStopped, match=r"licence.*\n.*E = 400.*no licence(.|\n)*server busy") as caught:
        campaign(path, model, design(300, 400, 500), policy)
    assert "tried again" in str(caught.value)
    assert model.calls == {300.0: 1, 400.0: 1}
    assert [record.state for record in campaign(path, model, design(300, 400, 500), policy)] == ["ok"] * 3
    assert model.calls == {300.0: 1, 400.0: 2, 500.0: 1}


def abreast(model, requests):
    """Have two runs under way, and tell how the second one ended."""
    for request in list(requests)[1:2]:
        yield attempt(model, request, Path())


def test_abort_leaves_a_run_beside_it_to_be_made_without_an_attempt_less(path):
    model, policy = Moody({400.0: 4}), FailurePolicy({"licence": "abort", "killed": "continue"})
    with Ledger.open(path, model="moody") as ledger:
        inputs = design(300, 400)
        for _ in range(4):
            with pytest.raises(CampaignStopped, match="this run is tried again, and so are those that were under way"):
                run_campaign(model, inputs, ledger=ledger, executor=abreast, maximum_attempts=1, policy=policy)
            beside, _ = ledger
            assert (beside.inputs["E"], beside.state, beside.failure_kind) == (300.0, "killed", INTERRUPTED)
            assert beside.message == "stopped with its campaign, for no reason of its own; it will be run again"
            assert ledger.attempts(beside.key) == 0
        done = run_campaign(model, inputs, ledger=ledger, executor=InProcess(), maximum_attempts=1, policy=policy)
    assert [record.state for record in done] == ["ok", "ok"]
    assert model.calls == {300.0: 1, 400.0: 5}


def test_failures_asked_for_again_are_run_once_more_and_no_others(path):
    model = Moody({400.0: 1, 500.0: 9})
    campaign(path, model, design(300, 400, 500))
    again = campaign(path, model, design(300, 400, 500), FailurePolicy(again=frozenset({"licence"})))
    assert [record.state for record in again] == ["ok", "ok", "failed"]
    assert model.calls == {300.0: 1, 400.0: 2, 500.0: 2}
    campaign(path, model, design(300, 400, 500), FailurePolicy(again=frozenset({"timeout"})))
    assert model.calls == {300.0: 1, 400.0: 2, 500.0: 2}


def test_failures_asked_for_again_get_all_their_retries(path):
    model = Moody({400.0: 4})
    policy = FailurePolicy({"licence": Retry(1)})
    assert campaign(path, model, design(400), policy)[0].state == "failed"
    once_more = FailurePolicy({"licence": Retry(1)}, again=frozenset({"failed"}))
    assert campaign(path, model, design(400), once_more)[0].state == "failed"
    assert model.calls[400.0] == 4


def test_a_campaign_all_of_whose_runs_fail_stops_early_and_says_why(path):
    stiffness = [300.0 + i for i in range(60)]
    model = Moody(dict.fromkeys(stiffness, 1))
    with pytest.raises(CampaignStopped, match=r"20 of 20 runs failed \(20 × licence\)(.|\n)*server busy"):
        campaign(path, model, design(*stiffness), FailurePolicy())
    assert sum(model.calls.values()) == 20


def test_a_campaign_most_of_whose_runs_fail_stops_where_the_policy_says(path):
    stiffness = [300.0 + i for i in range(60)]
    model = Moody({value: 1 for value in stiffness if value % 4})
    with pytest.raises(CampaignStopped, match="of 32 runs failed"):
        campaign(path, model, design(*stiffness), FailurePolicy(stop_after=32, stop_share=0.7))
    assert sum(model.calls.values()) == 32


def test_runs_of_an_earlier_campaign_do_not_stop_this_one(path):
    stiffness = [300.0 + i for i in range(24)]
    model = Moody(dict.fromkeys(stiffness[:19], 1))
    campaign(path, model, design(*stiffness[:19]))
    assert len(campaign(path, model, design(*stiffness), FailurePolicy())) == 24


def test_a_campaign_may_be_told_never_to_stop(path):
    stiffness = [300.0 + i for i in range(30)]
    model = Moody(dict.fromkeys(stiffness, 1))
    assert len(campaign(path, model, design(*stiffness[:25]), FailurePolicy(stop_share=2.0))) == 25
    assert len(campaign(path, model, design(*stiffness))) == 30


@pytest.mark.parametrize(
    "wrong", [{"actions": {"timeout": "recover"}}, {"stop_after": 0}, {"stop_share": 0.0}], ids=str
)
def test_senseless_policies_are_refused(wrong):
    with pytest.raises(InvalidInput):
        FailurePolicy(**wrong)


def test_no_retry_at_all_is_refused():
    with pytest.raises(InvalidInput, match="at least 1"):
        Retry(0)


def test_a_kind_that_no_run_ended_with_is_refused_with_those_there_are():
    require_kinds(["timeout"], {"timeout", "failed"})
    with pytest.raises(InvalidInput, match=r"got timout; expected one of failed, timeout"):
        require_kinds(["timout"], {"timeout", "failed"})
    with pytest.raises(InvalidInput, match="there is none"):
        require_kinds(["timeout"], set())
