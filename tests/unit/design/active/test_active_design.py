"""When an active design goes on, checks and stops."""

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import log_softmax
from tests.unit.design.active.fakes import SPACE, FakeLearner, interface, known, record, state_of

from strandline.design import sobol
from strandline.design.active import Active, ActiveDesign, ActiveRuns, Batch, posterior_check
from strandline.design.active import campaign as campaign_module
from strandline.design.active.checking import BatchCheck, LeftOut, Tolerances, number_of_probes, objections, verdict
from strandline.design.active.elsewhere import Surprise
from strandline.design.active.fidelities import Fidelities
from strandline.design.active.outcome import Certificate
from strandline.design.active.posterior_check import PosteriorCheck
from strandline.design.active.state import Remembered, State
from strandline.discrepancy import TrackedPoints
from strandline.errors import InvalidInput, TooFewRuns
from strandline.interface import Observation
from strandline.likelihood import InterfaceLikelihood
from strandline.likelihood.set_aside import Judge
from strandline.models.fidelities import by_cheaper
from strandline.posterior import reweight
from strandline.runs import FailurePolicy, RunRecord

FIRST = SPACE.to_physical(sobol(12, 2))
MEAN = np.array([0.2, 0.1])
PROBES = number_of_probes(2)


class Trusting(PosteriorCheck):
    """`FakeLearner` has a surrogate of its first runs only, which cannot be left out one by one."""

    odd: tuple[Surprise, ...] = ()
    odd_around: tuple[Surprise, ...] = ()
    chosen: set[bytes] | None = None

    def left_out(self, state: State, looked_around: set[bytes], chosen: set[bytes]) -> tuple[Surprise, ...]:
        self.chosen, (found, self.odd) = chosen, (self.odd, ())
        return found

    def near(self, state: State, records: Sequence[RunRecord]) -> LeftOut:
        return LeftOut(np.empty((0, 2)), np.empty(0), np.empty(0))


def honest(one: RunRecord) -> float:
    """Return the log-likelihood by which `FakeLearner` weighs its particles, of mean 0.2."""
    x = np.array([one.inputs["a"], one.inputs["b"]])
    return float(-0.5 * np.sum(((x - MEAN) / 0.2) ** 2))


def wrong(one: RunRecord) -> float:
    """The planted bug: another noise variance, a third."""
    return 3 * honest(one)


def design(
    active: Active,
    learn: Any = None,
    log_likelihood: Callable[[RunRecord], float] = honest,
    *,
    batch: int = 4,
    seed: int = 1,
    **check: Any,
) -> ActiveDesign:
    """Return a design that learns by a fake; its check trusts earlier runs."""
    options: dict[str, Any] = {"batch": batch, "log_likelihood": log_likelihood, "seed": seed}
    one = ActiveDesign(active, SPACE, learn=learn or FakeLearner(), **options)
    one.check = Trusting(active, SPACE, **options, **check)
    return one


def played(
    one: ActiveDesign,
    *,
    first: np.ndarray = FIRST,
    given: bool = False,
    fails: Callable[[np.ndarray], bool] | None = None,
) -> list[Batch]:
    """Run what is asked for until it stops; return the batches."""
    one.start(first, given=given)
    x = first
    while True:
        records = [record(row, ok=fails is None or not fails(row)) for row in x]
        batch = one.next(x, records)
        if batch is None:
            return one.batches
        assert len(x) < 1000
        x = np.concatenate([x, batch.points])


def kinds(batches: Sequence[Batch]) -> list[str]:
    return [batch.kind for batch in batches]


def sizes(batches: Sequence[Batch]) -> list[tuple[str, int]]:
    return [(batch.kind, len(batch.points)) for batch in batches]


def test_a_posterior_that_stays_is_checked_and_that_is_all() -> None:
    one = design(Active(100))
    batches = played(one)
    assert sizes(batches) == [("initial", 12), ("posterior", 4), ("posterior", 4), ("check", PROBES + 1)]
    assert one.converged
    assert one.reasons == ()
    check = one.steps[-1].check
    assert check is not None
    assert (check.draws, check.failed, check.passed, check.reasons, check.early) == (PROBES, 0, True, (), True)
    assert [step.runs for step in one.steps] == [12, 16, 20, 20 + PROBES + 1]
    assert [step.kind for step in one.steps] == kinds(batches)
    assert [step.since for step in one.steps] == [None, 12, 16, 20]
    assert one.steps[0].moved is None
    certificate = Certificate(one.converged, one.reasons, tuple(one.steps), tuple(one.batches), None, 0.1)
    assert "<td>12</td><td>initial</td><td></td>" in certificate._repr_html_()
    chosen = {row.tobytes() for batch in batches if batch.kind == "posterior" for row in batch.points}
    assert one.check.chosen == chosen


def test_batches_grow_with_the_runs_unless_their_size_is_stated() -> None:
    for batch, expected in [(None, [4, 5, 6, 16]), (4, [4] * 4)]:
        designs = [design(Active(2000, batch=batch)) for _ in expected]
        for one, first in zip(designs, (12, 100, 130, 1000), strict=True):
            one.start(SPACE.to_physical(sobol(first, 2)))
        assert [one._together for one in designs] == expected


@pytest.mark.parametrize(
    ("drift", "worse", "checks"), [(0.0, False, 1), (0.015, False, 2), (0.0, True, 2)], ids=["kept", "moved", "worse"]
)
def test_a_passed_check_is_kept_if_an_odd_run_far_away_changes_nothing(drift: float, worse: bool, checks: int) -> None:
    """An odd run is found once, and looked around; `worse`: runs around it are off too."""
    odd = (Surprise(np.array([0.9, 0.9]), False, 3.0),)

    class Around(Trusting):
        def surprises(self, *given: Any, strictly: bool = False) -> tuple[Surprise, ...]:
            return odd if worse and strictly else ()

    one = design(Active(100), FakeLearner([0.2] * 4 + [0.2 + drift]))
    one.check = Around(one.active, SPACE, batch=4, log_likelihood=honest, seed=1)
    one.check.odd = odd
    assert kinds(played(one))[:5] == ["initial", "posterior", "posterior", "check", "elsewhere"]
    assert kinds(one.batches).count("check") == checks
    assert one.converged
    first, last = (step.check for step in one.steps[3:5])
    assert first is not None
    assert not first.passed
    assert (last is not None) == (checks == 1)


@pytest.mark.parametrize(
    ("doubts", "possible", "kinds_after"),
    [
        (1, True, ["check", "trial"]),
        (2, True, ["check", "trial", "trial"]),
        (1, False, ["check", "posterior", "posterior", "check"]),
    ],
)
def test_what_is_doubted_is_tried_again_without_another_check(
    doubts: int, possible: bool, kinds_after: list[str]
) -> None:
    one, left = design(Active(100)), [("why",)] * doubts
    one.doubts = lambda state: left.pop() if left else ()
    one.another_trial = lambda: possible
    assert kinds(played(one))[3:] == kinds_after
    assert one.converged
    assert {len(batch.points) for batch in one.batches if batch.kind == "trial"} <= {3}


def test_a_posterior_that_moves_is_not_checked_yet() -> None:
    one = design(Active(200), FakeLearner([0.2, 0.3, 0.4, 0.2]))
    assert kinds(played(one)) == ["initial", *["posterior"] * 5, "check"]
    assert one.steps[1].moved is not None
    assert one.steps[1].moved.shift == pytest.approx(0.5, rel=0.15)


def test_a_posterior_that_is_another_one_from_the_prior_is_not_checked_yet() -> None:
    """The first time that it is sampled afresh its mean is two standard deviations away; the batch is chosen there."""
    found: list[State] = []

    def afresh(state: State) -> State:
        found.append(state if found else state_of(state.knowledge, mean=(0.6, 0.1)))
        return found[-1]

    one = design(Active(100))
    one.afresh = afresh
    batches = played(one)
    assert sizes(batches) == [("initial", 12), *[("posterior", 4)] * 3, ("check", PROBES + 1)]
    assert len(found) == 2
    assert batches[3].points[:, 0].mean() > batches[1].points[:, 0].mean() + 0.2


def test_a_check_knows_which_of_its_draws_are_probes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its last look leaves them out; here only that one settles anything."""
    seen = []

    def last_only(draws: np.ndarray, *given: Any, probing: int, last: bool, **options: Any) -> Any:
        seen.append((len(draws), probing))
        return BatchCheck(len(draws), 0, None, True, ()) if last else "open"

    monkeypatch.setattr(posterior_check, "verdict", last_only)
    played(design(Active(100)))
    assert [number for number, _ in seen] == [9, 13, 17, 25, 33, 34]  # a quarter more each time, in whole batches
    assert {probing for _, probing in seen} == {PROBES}


def test_a_check_that_fails_goes_on_until_the_runs_are_used_up() -> None:
    """A first batch that moved the posterior by two standard deviations is no reason any more."""
    one = design(Active(100), FakeLearner([0.6, 0.2]), log_likelihood=wrong)
    batches = played(one)
    assert not one.converged
    assert sum(len(batch.points) for batch in batches) == 100
    assert kinds(batches)[:7] == ["initial", *["posterior"] * 3, "check", "posterior", "posterior"]
    assert one.reasons[0] == "all 100 runs that were allowed are made"
    for words, told in [("draws are effective", 1), ("changes a standard deviation", 1), ("still moved", 0)]:
        assert any(words in reason for reason in one.reasons) == told
    assert max(step.moved.shift for step in one.steps if step.moved is not None) > 1.5


def test_the_last_runs_are_kept_for_a_check_which_may_come_after_a_batch_that_moved_the_posterior() -> None:
    one = design(Active(12 + 4 + 25), FakeLearner([0.2, 0.6]))
    assert sizes(played(one))[:3] == [("initial", 12), ("posterior", 4), ("check", PROBES)]
    assert one.steps[1].moved is not None
    assert one.steps[1].moved.shift > 1.5
    assert not one.converged
    few = design(Active(12 + 25 + 2), FakeLearner([0.2, 0.5, 0.2, 0.5]))
    assert sizes(played(few))[:3] == [("initial", 12), ("posterior", 2), ("check", PROBES)]


def test_a_posterior_that_never_rests_says_so_and_which_run_was_not_expected() -> None:
    one = design(Active(60), FakeLearner([0.2, -0.2] * 40))
    assert sum(len(batch.points) for batch in played(one)) == 60
    assert not one.converged
    assert "one of the last two batches still moved the posterior (by 2." in one.reasons[1]
    one._odd = (Surprise(np.array([0.9, 0.9]), False, 3.0),)
    assert one._odd[0].words(SPACE) in one._why_not()


def test_runs_too_few_for_a_check_are_used_all_the_same() -> None:
    """First runs that were added for want of successes have left five."""
    one = design(Active(37))
    one.start(FIRST)
    for _ in range(5):
        batch = one.more_of_the_first()
        assert batch is not None
        assert batch.kind == "initial"
    x = np.concatenate([batch.points for batch in one.batches])
    np.testing.assert_array_equal(x, SPACE.to_physical(sobol(32, 2)))
    for number in (4, 1):
        batch = one.next(x, [record(row) for row in x])
        assert batch is not None
        assert (batch.kind, len(batch.points)) == ("posterior", number)
        x = np.concatenate([x, batch.points])
    assert one.next(x, [record(row) for row in x]) is None
    assert one.reasons == (
        "all 37 runs that were allowed are made",
        "the posterior has not stood still for two batches yet",
        "no check on the true model was made",
    )


def test_no_run_is_left_over() -> None:
    for runs in (41, 42, 44, 47):
        one = design(Active(runs), log_likelihood=wrong)
        assert sum(len(batch.points) for batch in played(one)) == runs
        assert not one.converged
        assert any("effective" in reason for reason in one.reasons)


def test_no_more_than_allowed_of_the_first() -> None:
    """Runs besides the batches leave fewer."""
    one = design(Active(40))
    one.start(SPACE.to_physical(sobol(35, 2)))
    one.besides = 3
    assert len(one.more_of_the_first().points) == 2  # type: ignore[union-attr]
    assert one.more_of_the_first() is None


@pytest.mark.parametrize("line", [0.0, -2.0], ids=["many", "all"])
def test_a_check_whose_runs_fail_does_not_pass(line: float) -> None:
    one = design(Active(60))
    played(one, fails=lambda x: x[1] > line and not any(np.array_equal(x, row) for row in FIRST))
    check = next(step.check for step in one.steps if step.check is not None)
    assert not check.passed
    assert check.failed == check.draws if line < -1 else 1 < check.failed < check.draws
    assert (check.reweighting is None) or line == 0.0
    assert not one.converged


def test_each_tolerance_counts() -> None:
    """The weights are those of a surrogate that is off by half a standard deviation, or have a heavy tail."""
    x = np.random.default_rng(1).standard_normal((200, 1))
    off, turned, heavy = reweight(x, 0.5 * x[:, 0]), reweight(-x, 0.5 * x[:, 0]), reweight(x, 0.49 * x[:, 0] ** 2)
    loose = Tolerances(effective=0.01, shift=100.0, k_hat=100.0, width=100.0)
    assert objections(off, loose) == ()
    for name, value, reason in [
        ("effective", 0.999, "the effective sample size of the weights"),
        ("shift", 1e-9, "importance weights move a mean by"),
        ("width", 1e-9, "importance weights multiply a standard deviation by"),
    ]:
        (objection,) = objections(off, replace(loose, **{name: value}))
        assert reason in objection
    strict = replace(loose, shift=1e-9)
    assert objections(off, strict) == objections(turned, strict)
    k_hat = heavy.smoothed.k_hat
    assert objections(heavy, replace(loose, k_hat=0.3)) == (f"Pareto k̂ is {k_hat:.2f}, not below 0.3",)
    assert off.smoothed.k_hat > 0.03
    assert objections(off, replace(loose, k_hat=1e-9)) == ()


def test_a_region_elsewhere_that_fits_is_not_passed_over() -> None:
    """The surrogate rules out the corner at (-1, -1); the true model fits there."""

    def truth(one: RunRecord) -> float:
        x = np.array([one.inputs["a"], one.inputs["b"]])
        return 0.0 if (x < -0.3).all() else honest(one)

    first = FIRST[~(FIRST < -0.25).all(axis=1)]
    one = design(Active(100), log_likelihood=truth)
    batches = played(one, first=first)
    check = next(step.check for step in one.steps if step.check is not None)
    assert not check.passed
    assert check.reasons[0].startswith("a run at a -")
    assert check.reasons[0].endswith("fits the observation, which the surrogate had ruled out")
    assert batches[3].kind == "check"
    blind = design(Active(100, unseen=1.0), log_likelihood=truth)
    played(blind, first=first)
    assert blind.converged


@pytest.mark.parametrize(("factor", "passes"), [(1.0, True), (3.0, False), (1 / 3, False)])
def test_a_right_surrogate_passes_and_a_wrong_one_does_not(factor: float, passes: bool) -> None:
    """The truth is `factor` times the exponent: a noise variance three times what it is makes a posterior too wide."""
    for seed in range(2):
        one = design(Active(60), Still(seed), lambda r: factor * honest(r), seed=seed)
        played(one)
        assert (one.converged and kinds(one.batches).count("check") == 1) == passes


class Still(FakeLearner):
    """Learns a posterior whose particles are drawn by a seed."""

    def __init__(self, seed: int) -> None:
        self.state = state_of(known(FIRST), seed=seed)

    def __call__(self, x: np.ndarray, records: Sequence[RunRecord]) -> State:
        return replace(self.state, knowledge=replace(self.state.knowledge, x=x, ok=np.ones(len(x), bool)))


def given_design(factor: float) -> tuple[ActiveDesign, list[tuple[str, int]]]:
    """Return a design after given runs, and its batches; the truth is that of the surrogate times a factor."""

    def learn(x: np.ndarray, records: Sequence[RunRecord]) -> State:
        knowledge = known(x, noise=0.1)
        z = MEAN + 0.5 * np.random.default_rng(2).standard_normal((600, 2))
        z = z[np.all(np.abs(z) < 1, axis=1)]
        log_expected = knowledge.expected(z)
        weights = log_softmax(log_expected + 0.5 * np.sum(((z - MEAN) / 0.5) ** 2, axis=1))
        return State(knowledge, z, weights, weights, weights, log_expected, knowledge.plug_in(z))

    truth = InterfaceLikelihood((Observation(interface(MEAN), 0.1**2),), TrackedPoints())
    options: dict[str, Any] = {"batch": 8, "seed": 1, "log_likelihood": lambda r: factor * truth(r.interfaces)}
    one = ActiveDesign(Active(48, batch=8), SPACE, learn=learn, **options)
    return one, sizes(played(one, first=SPACE.to_physical(sobol(60, 2, scramble=5)), given=True))


def test_given_runs_are_checked_by_leaving_them_out() -> None:
    one, batches = given_design(1.0)
    assert batches == [("given", 60)]
    assert one.converged
    check = one.steps[0].check
    assert check is not None
    assert check.passed
    assert 20 <= check.draws < 60


def test_given_runs_that_object_are_gone_on_from() -> None:
    """The budget is that of new runs."""
    one, batches = given_design(4.0)
    assert len(batches) > 2
    assert batches[0] == ("given", 60)
    assert 40 <= sum(number for _, number in batches[1:]) <= 48
    assert not one.converged


def named(x: np.ndarray) -> list[dict[str, float]]:
    return [dict(SPACE.as_mapping(row)) for row in x]


def rows(batch: list[dict[str, float]]) -> np.ndarray:
    return np.array([[entry[name] for name in SPACE.names] for entry in batch])


def campaign(monkeypatch: pytest.MonkeyPatch, learner: FakeLearner) -> ActiveRuns:
    monkeypatch.setattr(campaign_module, "learn", lambda x, records, *others: (x, records))
    monkeypatch.setattr(campaign_module, "posterior_state", lambda given, *others, **options: learner(*given))
    seen, measure = (Observation(interface(MEAN), 0.01),), TrackedPoints()
    judge = Judge(seen, {"tracked_points": measure}, FailurePolicy())
    runs = ActiveRuns(Active(60), SPACE, measure, 4, 1, None, judge, aside=nullcontext, inputs=named)
    runs.design.check = Trusting(runs.active, SPACE, batch=4, log_likelihood=honest, seed=1)
    runs.design.afresh = lambda state: state
    return runs


def test_too_few_successes_ask_for_more_of_the_sequence(monkeypatch: pytest.MonkeyPatch) -> None:
    learner = FakeLearner(fewest=6)
    runs = campaign(monkeypatch, learner)
    first = SPACE.to_physical(sobol(5, 2))
    runs.design.start(first)
    found = rows(runs([record(row) for row in first]))
    np.testing.assert_array_equal(found, SPACE.to_physical(sobol(9, 2))[5:])
    assert len(runs([record(row) for row in runs.asked])) == 4
    assert kinds(runs.certificate.batches) == ["initial", "initial", "posterior"]
    learner.fewest = 1000
    while len(runs.asked) < 60:
        assert runs([record(row) for row in runs.asked])
    assert len(runs.asked) == 60
    with pytest.raises(TooFewRuns):
        runs([record(row) for row in runs.asked])


def test_a_campaign_ends_with_no_points(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = campaign(monkeypatch, FakeLearner())
    runs.design.start(FIRST)
    x = FIRST
    while batch := runs([record(row) for row in x]):
        x = np.concatenate([x, rows(batch)])
    assert runs.certificate.converged
    np.testing.assert_array_equal(runs.asked, x)


def test_a_check_takes_the_noise_that_was_inferred(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before anything is learnt, and if the noise is known, the stated one."""
    runs = campaign(monkeypatch, FakeLearner())
    one = record(MEAN + 0.3)
    stated = runs.judge.value(runs.judge.first, one)
    inferred = SimpleNamespace(likelihood=SimpleNamespace(one=lambda interfaces: stated - 1.0))
    for of, expected in [(None, stated), (inferred, stated - 1.0)]:
        runs.design.state = SimpleNamespace(knowledge=SimpleNamespace(likelihood=SimpleNamespace(inferred=of)))
        assert runs._true(one) == pytest.approx(expected)
    runs.design.state = None
    assert runs._true(one) == pytest.approx(stated)


def noisy(one: RunRecord) -> float:
    """A right likelihood with errors of 0.4, which no parabola explains."""
    error = np.random.default_rng(list(one.key.encode())).standard_normal()
    return honest(one) + 0.4 * float(error)


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """What each verdict is told."""
    all_of_it: list[dict[str, Any]] = []

    def spy(*given: Any, **options: Any) -> Any:
        all_of_it.append({"draws": given[0], "posterior": given[2], **options})
        return verdict(*given, **options)

    monkeypatch.setattr(posterior_check, "verdict", spy)
    return all_of_it


def test_a_check_that_could_not_settle_it_is_given_up_twice_at_most(told: list[dict[str, Any]]) -> None:
    """The posterior is learnt better instead, while there are runs enough for another check."""
    one = design(Active(120), log_likelihood=noisy)
    played(one)
    checks = [step.check for step in one.steps if step.check is not None]
    assert [check.given_up for check in checks[:3]] == [True, True, False]
    assert max(check.draws for check in checks[:2]) < 20 < checks[2].draws
    assert not any(check.early for check in checks[:2])
    assert told[0]["most"] == 34
    few = design(Active(70), log_likelihood=noisy)
    played(few)
    assert not any(step.check.given_up for step in few.steps if step.check is not None)


def test_a_check_is_told_what_errors_are_expected(told: list[dict[str, Any]]) -> None:
    """One of more inputs than a whole parabola has is not given up."""
    one = design(Active(100), log_likelihood=noisy, whole=1)
    played(one)
    assert one.state is not None
    variances, expected = one.state.knowledge.likelihood.variances, told[0]["expected"]
    assert not any("most" in options for options in told)
    np.testing.assert_allclose(expected.draws, variances(told[0]["draws"]))
    np.testing.assert_allclose(expected.posterior, variances(told[0]["posterior"]))
    assert expected.draws.max() > 2 * expected.draws.min() > 0


@pytest.mark.parametrize(("unseen", "elsewhere", "overlooks"), [(0.05, 12, False), (0.02, 17, True)])
def test_runs_that_a_check_has_left_look_where_none_has_been(unseen: float, elsewhere: int, overlooks: bool) -> None:
    """All runs that are left are set aside for draws of the check, which needs a few of them."""
    one = design(Active(46, unseen=unseen))
    assert sizes(played(one))[3:] == [("check", PROBES), ("elsewhere", elsewhere)]
    assert one.converged
    assert one.overlooks(np.concatenate([batch.points for batch in one.batches])) == overlooks


def test_a_design_knows_whether_its_runs_overlook_a_region() -> None:
    for unseen in (0.1, 0.5):
        one = design(Active(100, unseen=unseen))
        assert one.overlooks(FIRST[(FIRST < 0).all(axis=1)])
        assert not one.overlooks(SPACE.to_physical(sobol(64, 2)))


def test_runs_of_a_dropped_cheaper_model_have_not_looked(monkeypatch: pytest.MonkeyPatch) -> None:
    """The planted bug counts all runs that were asked for."""
    runs = campaign(monkeypatch, FakeLearner())
    runs.fidelities = Fidelities(SPACE.names, [""], 0.1)
    both = [record(row) for row in SPACE.to_physical(sobol(64, 2))]
    cheaper = [replace(one, inputs=by_cheaper(one.inputs)) for one in both[4:]]
    runs.design.start(SPACE.to_physical(sobol(64, 2)))
    runs.fidelities.drop("for a test")
    runs.fidelities.learn([*both[:4], *cheaper])
    assert runs.certificate.found > 0.2
    monkeypatch.setattr(ActiveRuns, "_looked", ActiveRuns.asked)
    assert runs.certificate.found < 0.1


def test_a_certificate_says_what_may_have_been_missed() -> None:
    few, many = (Certificate(False, ("no runs are left",), (), (), None, found) for found in (1.0, 0.07))
    assert few.statement == "The runs are too few to say whether another region fits."
    assert "compact region that fits, if it holds 7% or more of the prior's mass" in many.statement
    assert repr(few) == "<Certificate after 0 runs: not converged: no runs are left>"


def test_settings_have_ranges() -> None:
    """A batch may take all runs after the first, which are at least three."""
    wrong = {"check": 19, "initial": 2, "batch": 0, "explore": 0.6, "criterion": "entropy"}
    wrong |= {"effective": 1.0, "change": 0.0, "patience": 0.5, "runs": 27}
    for name, value in wrong.items():
        with pytest.raises(InvalidInput, match=f"^{name}"):
            Active(**{"runs": 100, name: value})  # type: ignore[arg-type]
    assert Active(30, batch=27).batch == 27
    assert Active(30, initial=5, batch=25).batch == 25
    with pytest.raises(InvalidInput, match="at most 27, the runs that are left of 30 after the first 3"):
        Active(30, batch=28)


def test_batches_of_fewer_runs_than_inputs_count_together() -> None:
    """Of one run each, in two dimensions: what moves the posterior by 0.075 standard deviations a run moves it on."""
    drifting = [0.0, 0.015, 0.03, 0.045, 0.06, 0.075, 0.09, 0.105]
    alone, together = (design(Active(60), FakeLearner(drifting), batch=batch) for batch in (2, 1))
    checked = [kinds(played(one)).index("check") for one in (alone, together)]
    assert [step.since for step in together.steps[:5]] == [None, None, 12, 13, 14]
    assert [step.since for step in alone.steps[:4]] == [None, 12, 14, 16]
    assert checked[0] == 3
    assert checked[1] > len(drifting)


def test_runs_with_derivatives_count_twice() -> None:
    """In two dimensions, a batch of one such run is compared with the one before."""
    learner = FakeLearner()

    def learn(x: np.ndarray, records: Sequence[RunRecord]) -> State:
        state: State = learner(x, records)
        likelihood = state.knowledge.likelihood
        likelihood = replace(likelihood, surrogate=replace(likelihood.surrogate, gradients=True))
        return replace(state, knowledge=replace(state.knowledge, likelihood=likelihood))

    with_derivatives, without = (design(Active(60), one, batch=1) for one in (learn, learner))
    assert kinds(played(with_derivatives))[:4] == ["initial", "posterior", "posterior", "check"]
    assert [step.since for step in with_derivatives.steps[:3]] == [None, 12, 13]
    played(without)
    assert [step.since for step in without.steps[:4]] == [None, None, 12, 13]


def test_weights_between_posteriors_count() -> None:
    """Widths that change by 8 % in both inputs leave means alone, and not all draws effective."""
    state = state_of(known(FIRST))
    narrower = state_of(known(FIRST), sd=0.2 * 0.92)
    moved = Remembered.of(state).moved(narrower.knowledge)
    assert moved.shift < 0.05
    assert moved.width == pytest.approx(-np.log(0.92), rel=0.2)
    assert moved.effective < 0.995
    strict = Active(60, effective=0.999, change=10.0)
    assert kinds(played(design(strict, FakeLearner([0.2, 0.22] * 50))))[1:4] == ["posterior"] * 3
    one_input = replace(state.knowledge, sd=np.array([0.2, 0.2 * 0.8]))
    assert Remembered.of(state).moved(one_input).width == pytest.approx(-np.log(0.8), rel=0.15)


def test_the_noise_of_particles_does_not_move_a_posterior() -> None:
    """Two samples of few particles differ by more than the tolerance; weights of one of them do not."""
    one, other = (state_of(known(FIRST), seed=seed, number=60) for seed in (1, 2))
    assert np.abs((one.mean - other.mean) / one.sd).max() > 0.1
    moved = Remembered.of(one).moved(other.knowledge)
    assert (moved.shift, moved.width, moved.effective) == pytest.approx((0.0, 0.0, 1.0), abs=1e-12)
    shifted = Remembered.of(one).moved(state_of(known(FIRST), mean=(0.3, 0.1)).knowledge)
    assert shifted.shift > 0.3
    assert shifted.effective < 0.9


def test_a_cheaper_model_makes_the_runs_until_it_is_dropped_for_want_of_a_correction(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    runs = campaign(monkeypatch, FakeLearner())
    batch = Batch(FIRST[:4], "initial")
    assert runs._runs(batch) == named(FIRST[:4])
    runs.fidelities = Fidelities(SPACE.names, [""], 0.1)
    assert runs._runs(batch) == [by_cheaper(entry) for entry in named(FIRST[:4])]
    runs._use(runs.fidelities)
    assert runs.fidelities.dropped == "there are too few inputs at which both models succeed"
    assert runs._runs(batch) == named(FIRST[:4])
    runs.fidelities = Fidelities(SPACE.names, [""], 0.1)
    x = SPACE.to_physical(sobol(8, 2))
    cheaper = [replace(one, inputs=by_cheaper(one.inputs)) for one in map(record, x)]
    runs.fidelities.learn([*cheaper, *map(record, x)])
    assert runs.fidelities.correction is not None
    runs._use(runs.fidelities)
    assert runs.fidelities.dropped is None
