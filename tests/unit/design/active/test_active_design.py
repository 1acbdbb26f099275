"""When an active design goes on, checks and stops."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import log_softmax
from tests.unit.design.active import fakes
from tests.unit.design.active.fakes import MEAN, SPACE, FakeLearner, even, honest, kinds, known, record, state_of

import strandline as sl
from strandline.design.active import Active, ActiveDesign
from strandline.design.active.campaign import Certificate
from strandline.design.active.checking import FEWEST_DRAWS, Tolerances, objections
from strandline.design.active.coverage_runs import Surprise
from strandline.design.active.posterior_check import PosteriorChecker
from strandline.design.active.state import PosteriorMove, State
from strandline.posterior import reweight

FIRST = even(12)
ODD = (Surprise(np.array([0.9, 0.9]), False, 3.0),)


def wrong(one):
    """The planted bug: another noise variance, a third."""
    return 3 * honest(one)


def design(active, learn=None, log_likelihood=honest, *, batch=4, seed=1, check=fakes.Trusting, **more):
    """Return a design that learns by a fake; its check trusts earlier runs."""
    options = {"batch": batch, "log_likelihood": log_likelihood, "seed": seed}
    one = ActiveDesign(active, SPACE, learn=learn or FakeLearner(), **options)
    one.check = check(active, SPACE, **options, **more)
    return one


def moving(*means, runs=100, **options):
    """Return a design of a posterior whose mean moves."""
    return design(Active(runs), FakeLearner(means), **options)


def played(one, *, first=FIRST, given=False, fails=lambda row: False):
    """Run what is asked for until it stops; return the batches."""
    one.start(first, given=given)
    x = first
    while (batch := one.next(x, [record(row, ok=not fails(row)) for row in x])) is not None:
        assert len(x) < 1000
        x = np.concatenate([x, batch.points])
    return one.batches


def sizes(batches):
    return [(batch.kind, len(batch.points)) for batch in batches]


def checks_of(one):
    return [step.check for step in one.steps if step.check is not None]


def test_a_posterior_that_stays_is_checked_and_that_is_all():
    one = design(Active(100))
    batches = played(one)
    assert sizes(batches) == [("initial", 12), ("posterior", 4), ("check", FEWEST_DRAWS + 2)]
    check = one.steps[-1].check
    assert (one.converged, one.reasons) == (True, ())
    assert (check.draws, check.failed, check.passed, check.reasons, check.early) == (FEWEST_DRAWS, 0, True, (), True)
    assert [step.runs for step in one.steps] == [12, 16, 16 + FEWEST_DRAWS + 2]
    assert [step.since for step in one.steps] == [None, 12, 16]
    assert one.steps[0].moved is None
    certificate = Certificate(one.converged, one.reasons, tuple(one.steps), tuple(one.batches), None, 0.1)
    assert "<td>12</td><td>initial</td><td></td>" in certificate._repr_html_()
    assert one.check.chosen == {row.tobytes() for batch in batches[1:2] for row in batch.points}
    searching = design(Active(100, explore=0.5))
    played(searching)
    assert len(searching.check.chosen) == 2, "runs that explore are not known to be draws of the posterior"


def test_draws_that_the_surrogate_hardly_knows_are_run_before_a_check_but_not_for_ever():
    class Ignorant(fakes.Trusting):
        def unknown(self, state, most):
            return state.positions[:2]

    batches = sizes(played(design(Active(100), check=Ignorant)))
    assert batches[1:8] == [("posterior", 4), *[("posterior", 2)] * 5, ("check", FEWEST_DRAWS + 2)]


def test_a_small_budget_keeps_half_of_it_for_a_check():
    for runs, kept in ((100, 25), (29, 25), (24, 10), (12, 6)):
        assert Active(runs, initial=4).kept_for_check == kept
    one = design(Active(16 + FEWEST_DRAWS, initial=12, unseen=1.0))
    assert kinds(played(one))[:3] == ["initial", "posterior", "check"]


@pytest.mark.parametrize(("drift", "worse", "kept"), [(0.0, False, True), (0.015, False, False), (0.0, True, False)])
def test_a_passed_check_is_kept_if_an_odd_run_far_away_changes_nothing(drift, worse, kept):
    """An odd run is found once, and looked around; `worse`: runs around it are off too."""

    class Around(fakes.Trusting):
        odd = ODD

        def surprises(self, *given, strictly=False):
            return ODD if worse and strictly else ()

    one = moving(0.2, 0.2, 0.2, 0.2 + drift, check=Around)
    assert kinds(played(one))[:4] == ["initial", "posterior", "check", "elsewhere"]
    assert (kinds(one.batches).count("check") == 1) == kept
    assert one.converged
    assert not one.steps[2].check.passed
    assert (one.steps[3].check is not None) == kept


@pytest.mark.parametrize(
    ("doubts", "possible", "kinds_after"),
    [(2, True, ["check", "trial", "trial"]), (1, False, ["check", "posterior", "posterior", "check"])],
)
def test_what_is_doubted_is_tried_again_without_another_check(doubts, possible, kinds_after):
    one, left = design(Active(100)), [("why",)] * doubts
    one.doubts = lambda state: left.pop() if left else ()
    one.another_trial = lambda: possible
    assert kinds(played(one))[2:] == kinds_after
    assert one.converged
    assert {len(batch.points) for batch in one.batches if batch.kind == "trial"} <= {3}


def test_a_posterior_that_is_another_one_from_the_prior_is_not_checked_yet():
    """The first time that it is sampled afresh its mean is two standard deviations away; the batch is chosen there."""
    found = []

    def afresh(state):
        found.append(state if found else state_of(state.knowledge, mean=(0.6, 0.1)))
        return found[-1]

    one = design(Active(100))
    one.afresh = afresh
    batches = played(one)
    assert sizes(batches) == [("initial", 12), *[("posterior", 4)] * 2, ("check", FEWEST_DRAWS + 1)]
    assert len(found) == 2
    assert np.median(batches[2].points[:, 0]) > np.median(batches[1].points[:, 0]) + 0.2


def test_a_check_that_fails_goes_on_until_the_runs_are_used_up():
    """A first batch that moved the posterior by two standard deviations is no reason any more."""
    one = moving(0.6, 0.2, log_likelihood=wrong)
    batches = played(one)
    assert not one.converged
    assert sum(len(batch.points) for batch in batches) == 100
    assert kinds(batches)[:6] == ["initial", *["posterior"] * 2, "check", "posterior", "posterior"]
    assert one.reasons[0] == "all 100 runs that were allowed are made"
    for words, told in [("predicted standard deviations", 1), ("still moved", 0)]:
        assert any(words in reason for reason in one.reasons) == told
    assert max(step.moved.shift for step in one.steps if step.moved is not None) > 1.5
    for runs in (41, 42, 44, 47):
        assert sum(len(batch.points) for batch in played(design(Active(runs), log_likelihood=wrong))) == runs


def test_the_last_runs_are_kept_for_a_check_which_may_come_after_a_batch_that_moved_the_posterior():
    one = moving(0.2, 0.6, runs=12 + 4 + 25)
    assert sizes(played(one))[:3] == [("initial", 12), ("posterior", 4), ("check", FEWEST_DRAWS)]
    assert one.steps[1].moved.shift > 1.5
    assert not one.converged


def test_a_posterior_that_never_rests_says_so_and_which_run_was_not_expected():
    one = moving(*[0.2, -0.2] * 40, runs=60)
    assert sum(len(batch.points) for batch in played(one)) == 60
    assert not one.converged
    assert "the log-likelihood at a draw is off by" in one.reasons[1]
    one.steps[-1] = replace(one.steps[-1], moved=PosteriorMove(2.0, 0.1, 0.5))
    assert "the last batch still moved the posterior (by 2.00 standard deviations" in one._why_not()[1]
    one._odd = ODD
    assert ODD[0].words(SPACE) in one._why_not()


def test_runs_too_few_for_a_check_are_used_all_the_same():
    """First runs that were added for want of successes have left five. Runs besides the batches leave fewer."""
    one, besides = design(Active(37)), design(Active(40))
    besides.start(even(35))
    besides.besides = 3
    assert len(besides.more_of_the_first().points) == 2
    assert besides.more_of_the_first() is None
    one.start(FIRST)
    assert [one.more_of_the_first().kind for _ in range(5)] == ["initial"] * 5
    x = np.concatenate([batch.points for batch in one.batches])
    np.testing.assert_array_equal(x, np.concatenate([FIRST, even(33)[13:]]))
    for number in (4, 1):
        batch = one.next(x, [record(row) for row in x])
        assert (batch.kind, len(batch.points)) == ("posterior", number)
        x = np.concatenate([x, batch.points])
    assert one.next(x, [record(row) for row in x]) is None
    assert one.reasons == ("all 37 runs that were allowed are made", "no check on the true model was made")


def test_a_check_whose_runs_fail_does_not_pass():
    one = design(Active(60))
    played(one, fails=lambda x: not any(np.array_equal(x, row) for row in FIRST))
    check = checks_of(one)[0]
    assert (check.passed, check.reweighting, one.converged) == (False, None, False)
    assert check.failed == check.draws


def test_failed_runs_of_all_batches_of_a_check_count():
    one = design(Active(60))
    played(one, fails=lambda x: x[1] > 0.1 and not any(np.array_equal(x, row) for row in FIRST))
    check = checks_of(one)[0]
    assert 3 < check.failed < check.draws
    assert check.draws > FEWEST_DRAWS
    assert "runs failed, more than 10%" in check.reasons[0]


def test_each_tolerance_counts():
    """The weights are those of a surrogate that is off by half a standard deviation, or have a heavy tail."""
    x = np.random.default_rng(1).standard_normal((200, 1))
    off, heavy = reweight(x, 0.5 * x[:, 0]), reweight(x, 0.49 * x[:, 0] ** 2)
    loose = Tolerances(effective=0.01, shift=100.0, k_hat=100.0, width=100.0)
    assert objections(off, loose) == ()
    for found, name, value, reason in [
        (off, "effective", 0.999, "the effective sample size of the weights"),
        (off, "shift", 1e-9, "importance weights move a mean by"),
        (off, "width", 1e-9, "importance weights multiply a standard deviation by"),
        (heavy, "k_hat", 0.3, f"Pareto k̂ is {heavy.smoothed.k_hat:.2f}, not below 0.3"),
    ]:
        (objection,) = objections(found, replace(loose, **{name: value}))
        assert reason in objection


def test_a_region_elsewhere_that_fits_is_not_passed_over():
    """The surrogate rules out the corner at (-1, -1); the true model fits there."""

    def truth(one):
        return 0.0 if (fakes.inputs_of(one) < -0.3).all() else honest(one)

    first = FIRST[~(FIRST < -0.25).all(axis=1)]
    one, blind = (design(active, log_likelihood=truth) for active in (Active(100), Active(100, unseen=1.0)))
    assert played(one, first=first)[2].kind == "check"
    (reason, *_) = checks_of(one)[0].reasons
    assert reason.startswith("a run at a -")
    assert reason.endswith("fits the observation, which the surrogate had ruled out")
    played(blind, first=first)
    assert blind.converged


@pytest.mark.parametrize("factor", [1.0, 4.0])
def test_given_runs_are_checked_by_leaving_them_out_and_gone_on_from_if_they_object(factor):
    """The truth is that of the surrogate times a factor. The budget is that of new runs."""

    def learn(x, records):
        knowledge = known(x, noise=0.1)
        z = MEAN + 0.5 * np.random.default_rng(2).standard_normal((600, 2))
        z = z[np.all(np.abs(z) < 1, axis=1)]
        log_expected = knowledge.expected(z)
        weights = log_softmax(log_expected - fakes.normal(z, sd=0.5))
        return State(knowledge, z, weights, weights, weights, log_expected, knowledge.plug_in(z))

    truth = sl.InterfaceLikelihood((sl.Observation(fakes.interface(MEAN), 0.1**2),), sl.TrackedPoints())
    options = {"batch": 8, "check": PosteriorChecker, "log_likelihood": lambda r: factor * truth(r.interfaces)}
    one = design(Active(48, batch=8), learn, **options)
    batches = sizes(played(one, first=even(60, 5), given=True))
    assert batches[0] == ("given", 60)
    if factor == 1.0:
        check = one.steps[0].check
        assert (len(batches), one.converged, check.passed) == (1, True, True)
        assert 20 <= check.draws < 60
    else:
        assert len(batches) > 2
        assert 40 <= sum(number for _, number in batches[1:]) <= 48
        assert not one.converged


def test_runs_that_a_check_has_left_look_where_none_has_been():
    """All runs that are left are set aside for draws of the check, which needs a few of them."""
    for unseen, elsewhere, overlooks in [(0.05, 13, False), (0.02, 20, True)]:
        one = design(Active(42, unseen=unseen))
        assert [one.overlooks(x) for x in (FIRST[(FIRST < 0).all(axis=1)], even(64))] == [True, overlooks]
        assert sizes(played(one))[2:] == [("check", FEWEST_DRAWS), ("elsewhere", elsewhere)]
        assert one.converged
        assert one.overlooks(np.concatenate([batch.points for batch in one.batches])) == overlooks


def test_weights_between_posteriors_count_and_the_noise_of_particles_does_not():
    """Two samples of few particles differ by more than the tolerance; weights of one of them do not."""
    knowledge = known(FIRST)
    one, other = (state_of(knowledge, seed=seed, number=60) for seed in (1, 2))
    assert np.abs((one.mean - other.mean) / one.sd).max() > 0.1
    moved = one.moved(other.knowledge)
    assert (moved.shift, moved.width, moved.effective) == pytest.approx((0.0, 0.0, 1.0), abs=1e-12)
    moved = one.moved(state_of(knowledge, mean=(0.3, 0.1)).knowledge)
    assert moved.shift > 0.3
    assert moved.effective < 0.9
    state = state_of(knowledge)
    one_input = replace(state.knowledge, sd=np.array([0.2, 0.2 * 0.8]))
    assert state.moved(one_input).width == pytest.approx(-np.log(0.8), rel=0.15)
    strict = design(Active(60, change=10.0), FakeLearner([0.2, 0.6] * 50))
    assert kinds(played(strict))[1:4] == ["posterior"] * 3


@pytest.mark.stand_in
def test_runs_with_derivatives_count_for_half_of_the_inputs():
    for dim, gradients, number in ((3, True, 2), (2, True, 1), (1, True, 1), (3, False, 3)):
        state = SimpleNamespace(knowledge=SimpleNamespace(surrogate=SimpleNamespace(gradients=gradients)))
        assert ActiveDesign._apart(SimpleNamespace(space=SimpleNamespace(dim=dim)), state) == number
