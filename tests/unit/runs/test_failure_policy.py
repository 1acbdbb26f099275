"""What a campaign does about runs that fail: nothing, another try, or an end of it all."""

from pathlib import Path

import pytest
from tests.unit.runs.fakes import Moody, campaign, design, states

from strandline.errors import CampaignStopped, InvalidInput
from strandline.runs import FailurePolicy, Ledger, Retry, RunRecord, attempt
from strandline.runs.failures import require_kinds
from strandline.runs.ledger import INTERRUPTED

MANY = [300.0 + i for i in range(26)]


def test_by_default_a_failed_run_is_left_out_and_not_tried_again(path):
    model = Moody({400.0: 9})
    assert states(campaign(path, model, design(300, 400, 500))) == ["ok", "failed", "ok"]
    campaign(path, model, design(300, 400, 500))
    assert model.calls == {300.0: 1, 400.0: 1, 500.0: 1}


def test_retry_tries_again_as_often_as_it_says(path):
    model, retry = Moody({400.0: 1, 500.0: 2, 600.0: 3}), FailurePolicy({"licence": Retry(2)})
    for _ in range(2):
        assert states(campaign(path, model, design(300, 400, 500, 600), policy=retry)) == ["ok", "ok", "ok", "failed"]
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


def test_failures_asked_for_again_are_run_once_more_and_no_others(path):
    model, inputs = Moody({400.0: 1, 500.0: 9}), design(300, 400, 500)
    campaign(path, model, inputs)
    again = campaign(path, model, inputs, policy=FailurePolicy(again=frozenset({"licence"})))
    assert states(again) == ["ok", "ok", "failed"]
    campaign(path, model, inputs, policy=FailurePolicy(again=frozenset({"timeout"})))
    assert model.calls == {300.0: 1, 400.0: 2, 500.0: 2}


def test_failures_asked_for_again_get_all_their_retries(path):
    model, retry = Moody({400.0: 4}), {"licence": Retry(1)}
    for policy in (FailurePolicy(retry), FailurePolicy(retry, again=frozenset({"failed"}))):
        assert states(campaign(path, model, design(400), policy=policy)) == ["failed"]
    assert model.calls[400.0] == 4


@pytest.mark.parametrize(
    ("failing", "policy", "said", "made"),
    [
        (MANY, FailurePolicy(), r"20 of 20 runs failed \(20 × licence\)(.|\n)*server busy", 20),
        (
            [value for value in MANY if value % 4],
            FailurePolicy(stop_after=12, stop_share=0.7),
            "9 of 12 runs failed",
            12,
        ),
    ],
)
def test_a_campaign_most_of_whose_runs_fail_stops_early_and_says_why(path, failing, policy, said, made):
    model = Moody(dict.fromkeys(failing, 1))
    with pytest.raises(CampaignStopped, match=said):
        campaign(path, model, design(*MANY), policy=policy)
    assert sum(model.calls.values()) == made


def test_failures_are_borne_where_they_are_of_an_earlier_campaign_or_the_policy_says_so(path):
    model = Moody(dict.fromkeys(MANY[:19], 1))
    campaign(path, model, design(*MANY[:19]))
    assert len(campaign(path, model, design(*MANY[:21]), policy=FailurePolicy())) == 21
    failing, other = Moody(dict.fromkeys(MANY, 1)), path.with_name("other.sqlite")
    assert len(campaign(other, failing, design(*MANY[:21]), policy=FailurePolicy(stop_share=2.0))) == 21
    assert len(campaign(other, failing, design(*MANY[:22]))) == 22


def test_what_makes_no_policy_is_refused():
    for wrong in ({"actions": {"timeout": "recover"}}, {"stop_after": 0}, {"stop_share": 0.0}):
        with pytest.raises(InvalidInput):
            FailurePolicy(**wrong)
    assert Retry().times == 1
    with pytest.raises(InvalidInput, match="at least 1"):
        Retry(0)
    require_kinds(["timeout"], {"timeout", "failed"})
    with pytest.raises(InvalidInput, match=r"got timout; expected one of failed, timeout"):
        require_kinds(["timout"], {"timeout", "failed"})
    with pytest.raises(InvalidInput, match="there is none"):
        require_kinds(["timeout"], set())
