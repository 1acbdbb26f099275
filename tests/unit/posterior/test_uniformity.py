"""Simultaneous bands: as often inside as they say, and posteriors that are wrong outside."""

import numpy as np
import pytest
from scipy.stats import binomtest, norm

from strandline.posterior.uniformity import coverage_of, uniformity, weighted_ranks


def ranks(*, shift: float = 0.0, width: float = 1.0, number: int = 200, seed: int = 1) -> np.ndarray:
    """Return ranks of the truth in Gaussian posteriors that are off by `shift` and too wide by `width`."""
    z = np.random.default_rng(seed).normal(size=number)
    return np.asarray(norm.cdf((z - shift) / width))


def test_uniform_ranks_are_inside_as_often_as_stated_and_their_p_values_uniform() -> None:
    bands = [uniformity(ranks(seed=seed, number=50)) for seed in range(400)]
    assert 0.92 < np.mean([band.inside for band in bands]) < 0.98
    for level in (0.1, 0.5, 0.9):
        assert abs(np.mean([band.p_value <= level for band in bands]) - level) < 0.08


def test_wrong_posteriors_are_outside() -> None:
    """Planted: a bias, too wide, too narrow, σ² taken for 2σ²."""
    for planted in ({"shift": 0.4}, {"width": 2.0}, {"width": 0.6}, {"width": np.sqrt(2.0)}):
        assert np.mean([not uniformity(ranks(seed=seed, **planted)).inside for seed in range(20)]) > 0.8


def test_coverage_of_intervals_with_the_bounds_of_wilson() -> None:
    both = np.stack([ranks(number=4000), ranks(number=4000, width=0.5, seed=2)], axis=1)
    found = coverage_of(both, 0.9)
    assert found.found[0] == pytest.approx(0.9, abs=0.02)
    assert found.low[0] < 0.9 < found.high[0]
    assert found.found[1] == pytest.approx(norm.cdf(0.5 * 1.645) * 2 - 1, abs=0.03)
    assert found.high[1] < 0.9
    few = coverage_of(np.array([0.5] * 17 + [0.99] * 3)[:, None], 0.9)
    wilson = binomtest(17, 20).proportion_ci(0.95, "wilson")
    assert (few.low[0], few.high[0]) == pytest.approx((wilson.low, wilson.high), rel=1e-6)


def test_ranks_are_weighted() -> None:
    x = np.array([[0.0, 5.0], [1.0, 5.0], [2.0, 7.0]])
    found = weighted_ranks(x, np.array([1.0, 1.0, 2.0]), np.array([1.0, 6.0]))
    np.testing.assert_allclose(found, [0.375, 0.5])
