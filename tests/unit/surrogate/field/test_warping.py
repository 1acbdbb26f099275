"""Inputs made straighter: standardised, monotone, and with the chain rule."""

import numpy as np
import pytest

from strandline.surrogate.field.warping import WARPS, Warping, eligible

LOW, HIGH = np.array([100.0, 0.5]), np.array([800.0, 2.0])
X = np.random.default_rng(1).uniform(LOW, HIGH, (7, 2))
PAIRS = [(a, b) for a in WARPS for b in WARPS]


def quantity(x: np.ndarray) -> np.ndarray:
    """Return three values a run."""
    a, b = x.T
    return np.stack([1e3 * b / a, np.log(a) * b, a * b**2 / 1e3], axis=1)


@pytest.mark.parametrize("names", PAIRS)
def test_gradients_follow_the_chain_rule(names: tuple[str, str]) -> None:
    warping = Warping(names, LOW, HIGH)
    by_input, by_standardised = [], []
    for j in range(2):
        step = 1e-5 * (HIGH - LOW) * np.eye(2)[j]
        change = quantity(X + step) - quantity(X - step)
        by_input.append(change / (2 * step[j]))
        gone = warping.standardise(X + step) - warping.standardise(X - step)
        by_standardised.append(change / gone[:, j : j + 1])
    found = warping.gradients(X, np.stack(by_input, axis=-1))
    np.testing.assert_allclose(found, np.stack(by_standardised, axis=-1), rtol=1e-6)


@pytest.mark.parametrize("name", list(WARPS))
def test_a_warp_is_monotone_and_its_slope_its_derivative(name: str) -> None:
    x = np.linspace(0.2, 9.0, 200)
    values = WARPS[name].apply(x)
    steps = np.diff(values)
    assert (steps > 0).all() or (steps < 0).all()
    np.testing.assert_allclose(WARPS[name].slope(x)[1:-1], np.gradient(values, x)[1:-1], rtol=0.06)


@pytest.mark.parametrize("names", PAIRS)
def test_the_box_spans_what_a_uniform_distribution_does(names: tuple[str, str]) -> None:
    """Mean 0 and deviation 1 of a uniform distribution over the warped box: from -√3 to √3."""
    ends = Warping(names, LOW, HIGH).standardise(np.stack([LOW, HIGH]))
    np.testing.assert_allclose(np.sort(ends, axis=0), np.sqrt(3.0) * np.array([[-1, -1], [1, 1]]), rtol=1e-12)


def test_only_wide_and_positive_inputs_are_warped() -> None:
    low, high = np.array([100.0, -0.8, 1.0, 0.0, 1.0]), np.array([800.0, 0.5, 1.5, 1.0, 2.0])
    assert eligible(low, high) == [0, 4]
