"""Inputs made straighter: standardised, monotone, and with the chain rule."""

from itertools import product

import numpy as np

from strandline.surrogate.field.warping import WARPS, Warping, eligible

LOW, HIGH = np.array([100.0, 0.5]), np.array([800.0, 2.0])
X = np.random.default_rng(1).uniform(LOW, HIGH, (7, 2))


def quantity(x: np.ndarray) -> np.ndarray:
    """Return three values a run."""
    a, b = x.T
    return np.stack([1e3 * b / a, np.log(a) * b, a * b**2 / 1e3], axis=1)


def test_gradients_follow_the_chain_rule_and_the_box_spans_what_a_uniform_distribution_does() -> None:
    """Mean 0 and deviation 1 of a uniform distribution over the warped box: from -√3 to √3."""
    for names in product(WARPS, repeat=2):
        warping, by_input, by_standardised = Warping(names, LOW, HIGH), [], []
        for j, step in enumerate(1e-5 * np.diag(HIGH - LOW)):
            change = quantity(X + step) - quantity(X - step)
            by_input.append(change / (2 * step[j]))
            gone = warping.standardise(X + step) - warping.standardise(X - step)
            by_standardised.append(change / gone[:, j : j + 1])
        found = warping.gradients(X, np.stack(by_input, axis=-1))
        np.testing.assert_allclose(found, np.stack(by_standardised, axis=-1), rtol=1e-6)
        ends = np.sort(warping.standardise(np.stack([LOW, HIGH])), axis=0)
        np.testing.assert_allclose(ends, np.sqrt(3.0) * np.array([[-1, -1], [1, 1]]), rtol=1e-12)


def test_a_warp_is_monotone_and_its_slope_its_derivative() -> None:
    x = np.linspace(0.2, 9.0, 200)
    for warp in WARPS.values():
        values = warp.apply(x)
        assert len(set(np.sign(np.diff(values)))) == 1
        np.testing.assert_allclose(warp.slope(x)[1:-1], np.gradient(values, x)[1:-1], rtol=0.06)


def test_only_wide_and_positive_inputs_are_warped() -> None:
    low, high = np.array([100.0, -0.8, 1.0, 0.0, 1.0]), np.array([800.0, 0.5, 1.5, 1.0, 2.0])
    assert eligible(low, high) == [0, 4]
