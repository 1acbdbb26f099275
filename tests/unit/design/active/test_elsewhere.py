"""Where nobody has looked: shares of the prior's mass, points to look at, what runs there and runs left out say."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp
from tests.unit.calibration import arches
from tests.unit.design.active import fakes
from tests.unit.design.active.fakes import MEAN, NOISE, SPACE, even, interface, known, record

import strandline as sl
from strandline.design.active import Active
from strandline.design.active import coverage_runs as module
from strandline.design.active import posterior_check as check_module
from strandline.design.active.choice import Losses
from strandline.design.active.coverage_runs import least_found, left_out_surprise, points_elsewhere, surprises
from strandline.design.active.posterior_check import left_out_ratios
from strandline.design.active.state import Knowledge, State, posterior_state
from strandline.surrogate.field import fit_field

X = even(24)
FAR = np.array([[-0.8, -0.7], [0.9, 0.8]])


def share_of_balls_with_a_run(x, share, dim):
    """Measure by brute force how many balls of this share of the cube hold a run."""
    random = np.random.default_rng(1)
    middles, cube = random.random((200, dim)), random.random((2000, dim))
    radii = [np.quantile(np.linalg.norm(cube - middle, axis=1), share) for middle in middles]
    nearest = [np.linalg.norm(x - middle, axis=1).min() for middle in middles]
    return np.mean(np.array(nearest) <= radii)


@pytest.mark.parametrize("dim", [1, 2, 4])
def test_regions_of_the_stated_share_hold_a_run(dim):
    space = sl.ParameterSpace(tuple(sl.Parameter(f"x{i}", sl.Uniform(0.0, 1.0)) for i in range(dim)))
    x = sl.sobol(30, dim, scramble=7)
    share = least_found(x, space)
    assert share_of_balls_with_a_run(x, share, dim) > 0.93
    smaller = module.SHARES[module.SHARES.index(share) - 1]
    assert share == module.SHARES[0] or share_of_balls_with_a_run(x, smaller, dim) < 0.97


def test_points_are_added_until_the_region_is_found():
    x = even(8)
    more = points_elsewhere(x, SPACE, 0.1, 50)
    assert 4 <= len(more) <= 16
    short, enough = (least_found(np.concatenate([x, some]), SPACE) for some in (more[:-1], more))
    assert min(least_found(x, SPACE), short) > 0.1 >= enough
    assert len(points_elsewhere(x, SPACE, 0.1, 3)) == 3
    assert len(points_elsewhere(np.array([[-1.0, -1.0]]), SPACE, 1.0, 50)) == 0


def test_priors_count_by_their_mass():
    """Points that cover the box of a narrow prior do not cover its mass."""
    a = sl.Parameter("a", sl.Normal(0.0, 1.0), box=(-20.0, 20.0))
    space = sl.ParameterSpace((a, sl.Parameter("b", sl.LogNormal(0.0, 1.0), box=(1e-3, 1e3))))
    spread = space.prior_quantiles(np.clip(sl.sobol(32, 2, scramble=3), 1e-3, 1 - 1e-3))
    assert least_found(spread, space) <= 0.07
    assert least_found(np.clip(spread * [10.0, 1.0], -19.0, 19.0), space) > least_found(spread, space)
    np.testing.assert_allclose(space.prior_quantiles(space.prior_shares(spread)), spread, rtol=1e-6)


@pytest.fixture(scope="module")
def state():
    return posterior_state(known(X), SPACE, (1,))


def with_likelihood(state, likelihood):
    return replace(state, knowledge=replace(state.knowledge, likelihood=likelihood))


def odd_of(state, true, rows=FAR, noise=NOISE):
    """Return the surprises of runs at `FAR` by their log-likelihoods."""
    return surprises(state, FAR, [record(row) for row in rows], true, 0.1, noise)


def test_a_run_that_fits_where_it_should_not_or_has_another_interface_is_a_surprise(state):
    true = state.knowledge.expected(FAR)
    assert odd_of(state, true) == odd_of(state, np.array([true[0], -40.0])) == ()
    (odd,) = odd_of(state, np.array([true[0], 0.0]))
    np.testing.assert_array_equal(odd.x, FAR[1])
    assert odd.words(SPACE) == "a run at a 0.9, b 0.8 fits the observation, which the surrogate had ruled out"
    exchanged = odd_of(state, np.full(2, -1e4), FAR[::-1], 0.1 * NOISE)
    assert ["predicted standard deviations from" in one.words(SPACE) for one in exchanged] == [True, True]


def test_a_region_counts_by_its_share_of_the_evidence(state, monkeypatch):
    """The evidence is integrated on a grid of the box. What an uncertain surrogate expects is no surprise."""
    g = np.linspace(-1.0, 1.0, 201)
    grid = np.stack([one.ravel() for one in np.meshgrid(g, g)], axis=1)
    log_evidence = float(logsumexp(state.knowledge.expected(grid))) - np.log(len(grid))
    threshold, expected = log_evidence + np.log(module.WEIGHTY) - np.log(0.1), state.knowledge.expected(FAR)
    for off, found in ((-0.3, 0), (0.3, 1)):
        assert threshold + off - expected[1] > module.UNLIKELY
        assert len(odd_of(state, np.array([expected[0], threshold + off]))) == found
    monkeypatch.setattr(Knowledge, "expected", lambda knowledge, x: np.full(len(x), threshold))
    assert odd_of(state, np.array([expected[0], threshold + 0.3])) == ()


def test_points_around_a_run_lie_around_it_and_apart():
    odd = np.array([[0.5, 0.5]])
    found = module.points_around(odd, even(8), SPACE, 0.1, 5)
    assert len(np.unique(found, axis=0)) == 5
    assert (np.linalg.norm(found[:, None] - found, axis=2) + 9 * np.eye(5)).min() > 0.2
    reach = 2 * np.sqrt(0.1 / np.pi)  # the box has sides of 2
    assert np.linalg.norm(found - odd, axis=1).max() < 1.3 * reach
    corner = module.points_around(np.array([[1.0, 1.0]]), even(8), SPACE, 0.1, 3)
    assert ((corner > -1) & (corner < 1)).all()


def spoiled_by(state, height):
    """Return the state whose sixth interface is higher than it should be."""
    interfaces = [{"": interface(row)} for row in X]
    interfaces[5] = {"": sl.Interface.polyline(interfaces[5][""].points + np.array([0.0, height]))}
    surrogate = fit_field(fakes.training(X, interfaces))
    return with_likelihood(state, replace(state.knowledge.likelihood, surrogate=surrogate))


def test_an_error_counts_beside_the_distance_from_the_posterior(state):
    mean = state.knowledge.surrogate.mean
    away = np.linalg.norm(mean(X[5:6]) - mean(state.mean[None]))
    small, large = (spoiled_by(state, share * away) for share in (0.06, 0.3))  # left-out errors of 4.5 and 25 % of it
    np.testing.assert_array_equal(left_out_surprise(large, 1e-3 * NOISE, set(), set()).x, X[5])
    found = [process.left_out() for process in small.knowledge.surrogate.processes]
    assert np.hypot.reduce([one.errors[5] for one in found]) > 2.05 * np.sqrt(sum(one.variances[5] for one in found))
    assert left_out_surprise(small, 1e-3 * NOISE, set(), set()) is None


def test_a_run_that_the_others_contradict_is_found_once(state):
    """Draws of the posterior are checked otherwise."""
    spoiled = spoiled_by(state, 0.05)
    found = left_out_surprise(spoiled, 0.2 * NOISE, set(), set())
    np.testing.assert_array_equal(found.x, X[5])
    assert not found.fits
    again = left_out_surprise(spoiled, 0.2 * NOISE, {X[5].tobytes()}, set())
    assert again is None or not np.array_equal(again.x, X[5])
    assert left_out_surprise(spoiled, 100 * NOISE, set(), set()) is None  # hidden by the noise
    assert left_out_surprise(state, 0.2 * NOISE, set(), set()) is None
    for on_posterior, unseen, number in [([], 0.1, 1), (X, 0.1, 0), ([], 1.0, 0)]:
        check = check_module.PosteriorChecker(Active(60, unseen=unseen), SPACE, batch=4, log_likelihood=float, seed=1)
        odd = check.left_out(spoiled, set(), {row.tobytes() for row in on_posterior})
        assert [one.x.tolist() for one in odd] == [X[5].tolist()] * number


def test_a_posterior_of_three_particles_is_checked_by_these(state):
    log_weights = np.full(len(state.positions), -np.inf)
    log_weights[:3] = -np.log(3)
    few, records = replace(state, log_weights=log_weights), [record(row) for row in X]
    check = check_module.PosteriorChecker(Active(60), SPACE, batch=4, log_likelihood=lambda run: -50.0, seed=1)
    begun = check.begin(few, X, 30, Losses(few.knowledge, 60, ()))
    assert len(begun) >= 3
    found, _ = check.verdict(np.concatenate([X, begun]), [*records, *map(record, begun)])
    assert found == "open" or not found.passed


def test_the_least_known_draw_comes_first_and_the_next_are_far_from_it(state, monkeypatch):
    check = check_module.PosteriorChecker(Active(60), SPACE, batch=4, log_likelihood=float, seed=1)
    monkeypatch.setattr(check_module, "UNKNOWN", 0.0)
    least, *others = found = check.unknown(state, 3)
    every, variances = check.unknown(state, 2000), state.knowledge.likelihood.variances
    assert variances(least[None])[0] == pytest.approx(variances(every).max())
    assert len(found) == 3
    assert len(np.unique(every, axis=0)) == len(every) == len(check._pool(state))
    assert min(np.linalg.norm((one - least) / state.sd) for one in others) > 1.0
    monkeypatch.setattr(check_module, "UNKNOWN", np.inf)
    assert check.unknown(state, 3).shape == (0, 2)


def test_a_check_draws_no_particle_that_has_run(state):
    """Of three heavy particles, two have run: without the rule, most draws would agree with themselves."""
    weights = np.full(len(state.positions), 1e-3)
    weights[:3] = 1.0
    heavy = replace(state, log_weights=np.log(weights / weights.sum()))
    plain = heavy.knowledge
    runs, ok = np.concatenate([plain.x, heavy.positions[:2]]), np.append(plain.ok, [True, True])
    seen = replace(plain, x=runs, ok=ok)
    found = {}
    for knowledge in (plain, seen):
        check = check_module.PosteriorChecker(Active(60, unseen=1.0), SPACE, batch=4, log_likelihood=float, seed=1)
        one = replace(heavy, knowledge=knowledge)
        drawn = np.concatenate([check.begin(one, X, 50, Losses(one.knowledge, 60, ())), check.more(one, ())])
        found[len(knowledge.x)] = {row.tobytes() for row in drawn} & {row.tobytes() for row in heavy.positions[:2]}
    assert [len(some) for some in found.values()] == [2, 0]


def test_a_check_draws_no_copy_of_a_particle(state):
    """Resampling copies particles; two copies are one run, which would count twice."""
    positions = state.positions.copy()
    positions[: len(positions) // 2] = positions[0]
    copied = replace(state, positions=positions)
    check = check_module.PosteriorChecker(Active(60, unseen=1.0), SPACE, batch=4, log_likelihood=float, seed=1)
    drawn = [check.begin(copied, X, 50, Losses(copied.knowledge, 60, ())), check.more(copied, ())]
    for some in drawn:
        assert len(np.unique(some, axis=0)) == len(some)
    weights = check_module._not_run(copied)
    assert weights[0] == pytest.approx(np.exp(copied.log_weights)[: len(positions) // 2].sum())


def test_runs_inside_are_those_of_the_expected_likelihood_and_ratios_are_of_the_true_one():
    runs = np.concatenate([X, [[0.2, 0.1], [0.4, 0.0]]])
    one, records = fakes.state_of(known(runs)), [record(row) for row in runs]
    one = replace(one, knowledge=replace(one.knowledge, doubt=1.8), log_expected=one.log_expected + 1.8)
    found = left_out_ratios(one, records, lambda run: 0.0, SPACE.log_prior)
    x, ratios, variances = found.x, found.values, found.variances
    within = ((runs - MEAN) ** 2).sum(axis=1) < 2 * 0.2**2 * -np.log(0.05)  # 95 % of a normal posterior
    assert within.sum() >= 2
    np.testing.assert_array_equal(x, runs[within])
    assert len(ratios) == len(variances) == within.sum()
    lower = left_out_ratios(one, records, lambda run: -0.3, SPACE.log_prior).values
    np.testing.assert_allclose(lower, ratios - 0.3)


def test_a_posterior_without_any_run_inside_has_no_ratios():
    """As in a narrow posterior that the first runs have missed: positions where the likelihood is far above theirs."""
    exact = sl.PointErrors(1e-5)
    likely = arches.knowledge(sl.NormalOffset(), {"": sl.Observation(arches.seen(exact), exact)})
    records = [replace(record(row), interfaces={"": arches.arch(row)}) for row in likely.x]
    positions = arches.TRUTH + 1e-5 * np.random.default_rng(0).standard_normal((50, 2))
    equal = np.full(50, -np.log(50.0))
    one = State(likely, positions, equal, equal, equal, np.zeros(50), np.zeros(50))
    found = left_out_ratios(one, records, lambda run: 0.0, arches.SPACE.log_prior)
    x, ratios, variances = found.x, found.values, found.variances
    assert (x.shape, len(ratios), len(variances)) == ((0, 2), 0, 0)
