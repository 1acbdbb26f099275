"""Where nobody has looked: shares of the prior's mass, points to look at, and what runs there say."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.special import logsumexp
from tests.unit.design.active.fakes import NOISE, SPACE, interface, known, record

from strandline.design import sobol
from strandline.design.active import Active
from strandline.design.active import elsewhere as module
from strandline.design.active import posterior_check as check_module
from strandline.design.active.elsewhere import (
    UNLIKELY,
    WEIGHTY,
    least_found,
    left_out_surprise,
    points_around,
    points_elsewhere,
    surprises,
)
from strandline.design.active.sampling import posterior_state
from strandline.design.active.state import State
from strandline.discrepancy import TrackedPoints
from strandline.interface import Interface, Observation
from strandline.likelihood import FieldLikelihood
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import LogNormal, Normal, Uniform
from strandline.surrogate.field import FieldTraining, fit_field


def share_of_balls_with_a_run(x: np.ndarray, share: float, dim: int, seed: int) -> float:
    """Measure by brute force how many balls of this share of the cube hold a run."""
    random = np.random.default_rng(seed)
    middles, cube = random.random((200, dim)), random.random((2000, dim))
    held = 0
    for middle in middles:
        radius = np.quantile(np.linalg.norm(cube - middle, axis=1), share)
        held += bool((np.linalg.norm(x - middle, axis=1) <= radius).any())
    return held / len(middles)


@pytest.mark.parametrize("dim", [1, 2, 4])
def test_regions_of_the_stated_share_hold_a_run(dim: int) -> None:
    space = ParameterSpace(tuple(Parameter(f"x{i}", Uniform(0.0, 1.0)) for i in range(dim)))
    x = sobol(30, dim, scramble=7)
    share = least_found(x, space)
    assert share_of_balls_with_a_run(x, share, dim, 1) > 0.93
    smaller = module.SHARES[module.SHARES.index(share) - 1] if share > module.SHARES[0] else 0.0
    assert smaller == 0 or share_of_balls_with_a_run(x, smaller, dim, 1) < 0.97


def test_points_are_added_until_the_region_is_found() -> None:
    x = SPACE.to_physical(sobol(8, 2))
    more = points_elsewhere(x, SPACE, 0.1, 50)
    assert 4 <= len(more) <= 16
    assert least_found(x, SPACE) > 0.1
    assert least_found(np.concatenate([x, more]), SPACE) <= 0.1
    assert least_found(np.concatenate([x, more[:-1]]), SPACE) > 0.1
    assert len(points_elsewhere(x, SPACE, 0.05, 50)) > 1.5 * len(more)
    assert len(points_elsewhere(x, SPACE, 0.1, 3)) == 3
    assert len(points_elsewhere(x, SPACE, 1.0, 50)) == 0
    assert len(points_elsewhere(np.array([[-1.0, -1.0]]), SPACE, 1.0, 50)) == 0


def test_priors_count_by_their_mass() -> None:
    """Points that cover the box of a narrow prior do not cover its mass."""
    space = ParameterSpace(
        (Parameter("a", Normal(0.0, 1.0), box=(-20.0, 20.0)), Parameter("b", LogNormal(0.0, 1.0), box=(1e-3, 1e3)))
    )
    even = space.prior_quantiles(np.clip(sobol(32, 2, scramble=3), 1e-3, 1 - 1e-3))
    wide = even * np.array([10.0, 1.0])
    assert least_found(even, space) <= 0.07
    assert least_found(np.clip(wide, -19.0, 19.0), space) > least_found(even, space)
    np.testing.assert_allclose(space.prior_quantiles(space.prior_shares(even)), even, rtol=1e-6)


X = SPACE.to_physical(sobol(24, 2))
FAR = np.array([[-0.8, -0.7], [0.9, 0.8]])


@pytest.fixture(scope="module")
def state() -> State:
    return posterior_state(known(X), SPACE, (1,))


def test_a_run_that_fits_where_it_should_not_is_a_surprise(state: State) -> None:
    records = [record(row) for row in FAR]
    true = state.knowledge.expected(FAR)
    assert surprises(state, FAR, records, true, 0.1, NOISE) == ()
    assert surprises(state, FAR[:0], [], np.empty(0), 0.1, NOISE) == ()
    true[1] = -40.0
    assert surprises(state, FAR, records, true, 0.1, NOISE) == ()
    true[1] = 0.0
    (odd,) = surprises(state, FAR, records, true, 0.1, NOISE)
    np.testing.assert_array_equal(odd.x, FAR[1])
    assert odd.words(SPACE) == "a run at a 0.9, b 0.8 fits the observation, which the surrogate had ruled out"


def test_a_run_with_another_interface_is_a_surprise(state: State) -> None:
    """The interfaces of the two runs are exchanged."""
    records = [record(row) for row in FAR[::-1]]
    found = surprises(state, FAR, records, np.full(2, -1e4), 0.1, 0.1 * NOISE)
    assert len(found) == 2
    assert "predicted standard deviations from" in found[0].words(SPACE)


def test_points_around_a_run_lie_around_it_and_apart() -> None:
    x = SPACE.to_physical(sobol(8, 2))
    odd = np.array([[0.5, 0.5]])
    found = points_around(odd, x, SPACE, 0.1, 5)
    assert len(np.unique(found, axis=0)) == 5
    apart = np.linalg.norm(found[:, None] - found, axis=2) + 9 * np.eye(5)
    assert apart.min() > 0.2
    reach = 2 * np.sqrt(0.1 / np.pi)  # the box has sides of 2
    assert np.linalg.norm(found - odd, axis=1).max() < 1.3 * reach
    corner = points_around(np.array([[1.0, 1.0]]), x, SPACE, 0.1, 3)
    assert ((corner > -1) & (corner < 1)).all()


@pytest.fixture(scope="module")
def spoiled(state: State) -> State:
    """The posterior after runs one of whose interfaces is higher than it should be."""
    interfaces = [{"": interface(row)} for row in X]
    interfaces[5] = {"": Interface.polyline(interfaces[5][""].points + np.array([0.0, 0.05]))}
    surrogate = fit_field(FieldTraining(X, interfaces, None, SPACE.low, SPACE.high))
    likelihood = replace(state.knowledge.likelihood, surrogate=surrogate)
    return replace(state, knowledge=replace(state.knowledge, likelihood=likelihood))


def test_a_run_that_the_others_contradict_is_found_once(state: State, spoiled: State) -> None:
    found = left_out_surprise(spoiled, 0.2 * NOISE, set(), set())
    assert found is not None
    np.testing.assert_array_equal(found.x, X[5])
    assert not found.fits
    again = left_out_surprise(spoiled, 0.2 * NOISE, {X[5].tobytes()}, set())
    assert again is None or not np.array_equal(again.x, X[5])
    assert left_out_surprise(spoiled, 100 * NOISE, set(), set()) is None  # hidden by the noise
    assert left_out_surprise(state, 0.2 * NOISE, set(), set()) is None


def test_the_worst_of_many_runs_may_be_farther_off(spoiled: State, monkeypatch: pytest.MonkeyPatch) -> None:
    assert [module._largest_usual(number) for number in (1, 20, 43)] == [2.0] * 3
    assert module._largest_usual(1000) == pytest.approx(3.09, abs=0.01)
    errors = np.random.default_rng(1).standard_normal((400, 1000))
    farther = (np.abs(errors) > module._largest_usual(1000)).sum(axis=1)
    assert farther.mean() == pytest.approx(2.0, abs=0.3)
    monkeypatch.setattr(module, "_largest_usual", lambda number: 10.0)
    assert left_out_surprise(spoiled, 0.2 * NOISE, set(), set()) is None


def test_draws_of_the_posterior_are_checked_otherwise(spoiled: State) -> None:
    given: dict[str, Any] = {"batch": 4, "log_likelihood": float, "seed": 1}
    for on_posterior, unseen, found in [(set(), 0.1, 1), ({row.tobytes() for row in X}, 0.1, 0), (set(), 1.0, 0)]:
        check = check_module.PosteriorCheck(Active(60, unseen=unseen), SPACE, **given)
        odd = check.left_out(spoiled, set(), on_posterior)
        assert [one.x.tolist() for one in odd] == [X[5].tolist()] * found


def test_the_condition_with_the_least_noise_decides_what_is_hidden(state: State) -> None:
    """`TrackedPoints` with σ_N hides a shift of σ_N along each of the nodes together."""
    training = FieldTraining(X, [{"a": interface(row), "b": interface(row)} for row in X], None, SPACE.low, SPACE.high)
    seen = [Observation(interface(X[3]), noise**2, name) for name, noise in (("a", 0.02), ("b", 0.005))]
    field = fit_field(training)
    both, finest = (FieldLikelihood(field, tuple(some), TrackedPoints()) for some in (seen, [seen[1], seen[1]]))
    hidden = [
        check_module._hidden(replace(state, knowledge=replace(state.knowledge, likelihood=one)))
        for one in (both, finest)
    ]
    assert hidden[0] == pytest.approx(hidden[1])
    assert hidden[0] < 0.005


def test_a_region_counts_by_its_share_of_the_evidence(state: State) -> None:
    """The evidence is integrated on a grid of the box."""
    g = np.linspace(-1.0, 1.0, 201)
    grid = np.stack([one.ravel() for one in np.meshgrid(g, g)], axis=1)
    log_evidence = float(logsumexp(state.knowledge.expected(grid))) - np.log(len(grid))
    threshold = log_evidence + np.log(WEIGHTY) - np.log(0.1)
    for off, found in ((-0.3, 0), (0.3, 1)):
        true = state.knowledge.expected(FAR)
        true[1] = threshold + off
        assert true[1] - state.knowledge.expected(FAR)[1] > UNLIKELY
        assert len(surprises(state, FAR, [record(row) for row in FAR], true, 0.1, NOISE)) == found
