"""Which combinations of the inputs are left unknown, on problems with a known answer."""

import numpy as np
import pytest

import strandline as sl
from strandline.planning.identifiability import Direction, directions_left, directions_of, in_words, scale_of

SPACE = sl.ParameterSpace((
    sl.Parameter("E", sl.LogNormal(6.0, 0.5), "Pa", box=(10.0, 10000.0)),
    sl.Parameter("V", sl.LogNormal(3.0, 0.5), box=(1.0, 1000.0)),
    sl.Parameter("nu", sl.Normal(0.0, 0.2), box=(-1.0, 0.5)),
))  # fmt: skip


def information(x: np.ndarray) -> np.ndarray:
    """Return the Fisher information of an interface that shows V/E and ν only, each to a hundredth."""
    rows = np.array([[-x[1] / x[0] ** 2, 1 / x[0], 0.0], [0.0, 0.0, 1.0]])
    sds = np.array([0.01 * x[1] / x[0], 0.01])
    return np.asarray((rows / sds[:, None]).T @ (rows / sds[:, None]))


def test_a_common_factor_of_stiffness_and_load_is_left_unknown_wherever_the_draws_are() -> None:
    scale = scale_of(SPACE)
    np.testing.assert_allclose(scale.sd, [0.5, 0.5, 0.2], rtol=0.03)
    x = SPACE.prior_quantiles(sl.sobol(8, 3, scramble=0))
    worst, *others = directions_left(scale, x, [information(row) for row in x])
    assert worst.left == pytest.approx(1.0, abs=1e-3)
    np.testing.assert_allclose(worst.weights, [0.5**0.5, 0.5**0.5, 0.0], atol=0.02)
    assert max(one.left for one in others) < 0.06
    assert in_words(worst, SPACE.names) == "E up and V up (1 : 1)"


def test_what_is_left_is_that_of_a_normal_posterior() -> None:
    """Draws of the posterior of a linear problem have the widths that the information predicts."""
    random = np.random.default_rng(1)
    slopes = np.array([[3.0, 1.0, 0.0], [0.0, 1.0, 2.0]])
    draws = random.standard_normal((50_000, 3))
    seen = slopes @ np.array([0.2, -0.1, 0.3])
    weights = np.exp(-0.5 * ((draws @ slopes.T - seen) ** 2).sum(axis=1))
    found = directions_of(np.cov(draws.T, aweights=weights))
    foretold = directions_of(np.linalg.inv(np.eye(3) + slopes.T @ slopes))
    for one, other in zip(found, foretold, strict=True):
        assert one.left == pytest.approx(other.left, rel=0.03)
        assert abs(one.weights @ other.weights) > 0.998


def test_combinations_that_are_equally_unknown_have_few_inputs_each() -> None:
    """Any rotation of E + V and ν describes what two of four directions leave; the one of fewest inputs is chosen."""
    first, second = np.array([1, 1, 0, 0]) / 2**0.5, np.array([0, 0, 1.0, 0])
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    unknown = np.stack([first, second]).T @ turn
    known = np.array([[1, -1, 0, 0], [0, 0, 0, 2**0.5]]).T / 2**0.5
    covariance = unknown @ np.diag([1.0, 0.99]) @ unknown.T + 0.1 * known @ known.T
    words = {in_words(one, ("E", "V", "nu", "h")) for one in directions_of(covariance)[:2]}
    assert words == {"E up and V up (1 : 1)", "nu"}
    assert in_words(Direction(np.array([-0.1, 0.8, -0.59]), 0.9), ("a", "b", "c")) == "b up and c down (1 : 0.74)"
