"""Kernel density estimates against SciPy, scikit-learn, brute force and known densities."""

import numpy as np
import pytest
from scipy.stats import chi2, gaussian_kde, truncnorm, uniform

from strandline.foundations import InvalidInput, NumericsError
from strandline.posterior import KernelDensity, enclosing_levels
from strandline.posterior.densities import slope_correction

UNIT = [(0.0, 1.0)]


def cloud(number=300, dim=2):
    rng = np.random.default_rng(0)
    draws = rng.normal(size=(number, dim)) @ np.array([[100.0, 0.3], [0.0, 0.4]])[:dim, :dim]
    weights = rng.exponential(size=number)
    return draws, weights / weights.sum()


def equal(draws, **options):
    return KernelDensity.fit(draws, np.full(len(draws), 1 / len(draws)), **options)


def test_the_density_is_that_of_scipy():
    draws, weights = cloud()
    ours = KernelDensity.fit(draws, weights, bandwidth=0.4)
    unbiased = np.sqrt(1 - np.sum(weights**2))
    theirs = gaussian_kde(draws.T, bw_method=0.4 * unbiased, weights=weights)
    points = draws[:50] * 1.1
    np.testing.assert_allclose(ours.density(points), theirs(points.T), rtol=1e-9)
    planted = equal(draws, bandwidth=0.4).density(points)
    assert not np.allclose(planted, theirs(points.T), rtol=0.02), "unweighted kernels must be caught"


def test_the_bandwidth_is_the_optimum_of_leaving_one_out_by_brute_force_and_near_the_normal_rule():
    draws, weights = cloud(40, dim=1)
    draws = draws / 100.0
    sd = np.sqrt(weights @ (draws[:, 0] - weights @ draws[:, 0]) ** 2)

    def score(h):
        total = 0.0
        for i in range(40):
            rest = np.delete(np.arange(40), i)
            kernels = np.exp(-0.5 * ((draws[i] - draws[rest, 0]) / (h * sd)) ** 2) / (h * sd)
            total += weights[i] * np.log(kernels @ weights[rest] / weights[rest].sum())
        return total

    found = KernelDensity.fit(draws, weights).bandwidth
    assert np.argmax([score(found * factor) for factor in (0.85, 0.93, 1.0, 1.07, 1.15)]) == 2
    found = equal(np.random.default_rng(5).normal(size=(900, 2))).bandwidth
    assert found == pytest.approx(900 ** (-1 / 6), rel=0.3)
    whole, thinned = (KernelDensity.fit(*cloud(900), **options).bandwidth for options in ({}, {"loo_points": 225}))
    assert thinned == pytest.approx(whole, rel=0.25)


def test_levels_enclose_their_mass():
    """For a normal density the level of mass p is the density at the chi-square radius."""
    draws = np.random.default_rng(6).normal(size=(2000, 2))
    density, percentiles = equal(draws, bandwidth=0.3), [0.1, 0.5, 0.9]
    grid = np.stack(np.meshgrid(*2 * [np.linspace(-4.5, 4.5, 41)]), axis=-1).reshape(-1, 2)
    levels = enclosing_levels(density.density(grid).reshape(41, 41), percentiles)
    expected = np.exp(-0.5 * chi2.ppf(percentiles, 2)) / (2 * np.pi * (1 + density.bandwidth**2))
    np.testing.assert_allclose(levels, expected, rtol=0.1)
    inside = density.density(draws[:1000])
    np.testing.assert_allclose([(inside > level).mean() for level in levels], percentiles, atol=0.05)
    rising = np.broadcast_to(np.linspace(0.0, 2.0, 11), (3, 11))
    for one in (rising, rising[:, ::-1]):
        assert enclosing_levels(one, [0.19])[0] == pytest.approx(1.8, abs=0.01), "points at an end count half"
    with pytest.raises(InvalidInput, match="percentile"):
        enclosing_levels(rising, [50.0])
    with pytest.raises(NumericsError, match="spread in every direction"):
        equal(np.ones((10, 1)))


BOUNDED = {
    "uniform": (uniform(-1e-9, 1 + 2e-9), 0.11),
    "normal, mode outside": (truncnorm(1.0 - 1e-9, 6.0 + 1e-9, loc=-0.2, scale=0.2), 0.07),
    "normal, falls to the upper bound": (truncnorm(-3.5, 0.5 + 1e-9, loc=0.9, scale=0.2), 0.08),
}
"""Densities on [0, 1] and the largest error that is allowed, as a share of their maximum."""


def estimate(draws):
    return equal(np.clip(draws, 0.0, 1.0)[:, None], bounds=UNIT, loo_points=500)


def test_the_largest_error_of_a_density_with_bounds_and_mirrored_kernels_alone_miss_the_slope(monkeypatch):
    """A density that falls to zero at its bound is not overshot either: mirrored kernels give 0.16 of the maximum."""
    grid, zero = np.linspace(0.0, 1.0, 101), np.zeros((1, 1))
    drawn = {name: one.rvs(5000, random_state=np.random.default_rng(3)) for name, (one, _) in BOUNDED.items()}
    for name, (exact, allowed) in BOUNDED.items():
        found, truth = estimate(drawn[name]).density(grid[:, None]), exact.pdf(grid)
        assert np.abs(found - truth).max() / truth.max() < allowed, name
        assert np.trapezoid(found, grid) == pytest.approx(1.0, abs=1e-3)
    one = equal(np.random.default_rng(1).exponential(0.25, (300, 1)), bounds=[(0.0, np.inf)])
    wide = np.linspace(0.0, 3.0, 3001)
    assert np.trapezoid(one.density(wide[:, None]), wide) == pytest.approx(1.0, abs=1e-3), "with one bound"
    falling = np.random.default_rng(0).beta(2.0, 3.0, 5000)
    assert estimate(falling).density(zero)[0] < 0.1 * 1.7778
    monkeypatch.setattr("strandline.posterior.densities.slope_correction", lambda points, *rest: np.zeros(len(points)))
    exact, allowed = BOUNDED["normal, mode outside"]
    found = estimate(drawn["normal, mode outside"]).density(zero)
    assert abs(found[0] - exact.pdf(0.0)) / exact.pdf(0.0) > allowed


def test_kernels_are_mirrored_at_the_bounds():
    """In one dimension up to the edge; in two, the mass of correlated kernels stays in the box."""
    draws = np.random.default_rng(0).uniform(-0.8, 0.5, (1000, 1))
    edge, middle = np.array([[-0.8], [0.5]]), (np.arange(100) + 0.5) / 100
    mirrored = equal(draws, bounds=[(-0.8, 0.5)])
    np.testing.assert_allclose(mirrored.density(edge), 1 / 1.3, rtol=0.15)
    planted = equal(draws, bandwidth=mirrored.bandwidth)
    assert (planted.density(edge) < 0.6 / 1.3).all(), "a leaking estimate must be caught"
    np.testing.assert_array_equal(mirrored.density(np.array([[-0.81], [0.51]])), 0.0)
    rng = np.random.default_rng(4)
    x = rng.uniform(0.0, 1.0, 60)
    draws = np.stack([x, np.clip(x + 0.1 * rng.normal(size=60), 0, 1)], axis=1)
    density = equal(draws, bounds=2 * UNIT)
    grid = np.stack(np.meshgrid(middle, middle), axis=-1).reshape(-1, 2)
    assert density.density(grid).mean() == pytest.approx(1.0, abs=2e-3)
    assert equal(draws, bandwidth=density.bandwidth).density(grid).mean() < 0.95


def test_a_slope_that_draws_do_not_support_is_shrunk():
    """By its own sampling variance: to nothing where it is larger than the square of the difference."""
    at, width = np.array([0.1]), 0.3
    centres = np.random.default_rng(2).random(12)
    weights = np.full(12, 1 / 12)
    few = slope_correction(at, centres, weights, width, (0.0, np.inf))[0]
    many = slope_correction(at, np.repeat(centres, 400), np.repeat(weights, 400) / 400, width, (0.0, np.inf))[0]
    assert 0 <= abs(few) < 0.9 * abs(many)
