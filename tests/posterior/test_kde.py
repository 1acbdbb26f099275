"""Kernel density estimates against SciPy, scikit-learn, brute force and known densities."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import chi2, gaussian_kde, truncnorm, uniform
from sklearn.neighbors import KernelDensity as ReferenceDensity

from strandline.errors import InvalidInput, NumericsError
from strandline.posterior import KernelDensity


def cloud(number: int = 300, dim: int = 2, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    draws = rng.normal(size=(number, dim)) @ np.array([[100.0, 0.3], [0.0, 0.4]])[:dim, :dim]
    weights = rng.exponential(size=number)
    return draws, weights / weights.sum()


def test_density_equals_scipy():
    draws, weights = cloud()
    ours = KernelDensity.fit(draws, weights, bandwidth=0.4)
    unbiased = np.sqrt(1 - np.sum(weights**2))
    theirs = gaussian_kde(draws.T, bw_method=0.4 * unbiased, weights=weights)
    points = draws[:50] * 1.1
    np.testing.assert_allclose(ours.density(points), theirs(points.T), rtol=1e-9)
    planted = KernelDensity.fit(draws, np.full(300, 1 / 300), bandwidth=0.4).density(points)
    assert not np.allclose(planted, theirs(points.T), rtol=0.02), "unweighted kernels must be caught"


def test_column_shape_equals_scikit_learn_on_standardised_columns():
    draws, weights = cloud()
    sd = np.sqrt(weights @ (draws - weights @ draws) ** 2)
    ours = KernelDensity.fit(draws, weights, bandwidth=0.3, shape="columns")
    theirs = ReferenceDensity(bandwidth=0.3, rtol=1e-10).fit(draws / sd, sample_weight=weights)
    points = draws[::7]
    np.testing.assert_allclose(ours.density(points), np.exp(theirs.score_samples(points / sd)) / sd.prod(), rtol=1e-6)


def test_bandwidth_is_the_brute_force_leave_one_out_optimum():
    draws, weights = cloud(60, dim=1)
    draws = draws / 100.0
    sd = np.sqrt(weights @ (draws[:, 0] - weights @ draws[:, 0]) ** 2)

    def score(h: float) -> float:
        total = 0.0
        for i in range(60):
            rest = np.delete(np.arange(60), i)
            model = ReferenceDensity(bandwidth=h * sd, rtol=1e-10).fit(draws[rest], sample_weight=weights[rest])
            total += weights[i] * model.score_samples(draws[i : i + 1])[0]
        return total

    found = KernelDensity.fit(draws, weights).bandwidth
    grid = found * np.array([0.85, 0.93, 1.0, 1.07, 1.15])
    assert np.argmax([score(h) for h in grid]) == 2


def test_bandwidth_of_normal_draws_is_near_the_normal_rule():
    draws = np.random.default_rng(5).normal(size=(900, 2))
    found = KernelDensity.fit(draws, np.full(900, 1 / 900))
    assert found.bandwidth == pytest.approx(900 ** (-1 / 6), rel=0.3)


def test_copies_do_not_change_the_density():
    draws, weights = cloud(200)
    copies = np.random.default_rng(1).integers(1, 5, 200)
    repeated = np.repeat(draws, copies, axis=0)
    repeated_weights = np.repeat(weights / copies, copies)
    one, two = KernelDensity.fit(draws, weights), KernelDensity.fit(repeated, repeated_weights)
    assert two.bandwidth == pytest.approx(one.bandwidth, rel=1e-6)
    assert one.bandwidth > 0.05
    np.testing.assert_allclose(two.density(draws), one.density(draws), rtol=1e-6)


def test_resampled_draws_keep_the_bandwidth_from_collapsing():
    draws, weights = cloud(400)
    chosen = np.random.default_rng(2).choice(400, 3000, p=weights)
    reference = KernelDensity.fit(draws, weights).bandwidth
    found = KernelDensity.fit(draws[chosen], np.full(3000, 1 / 3000), loo_points=800).bandwidth
    assert found == pytest.approx(reference, rel=0.35)


def test_thinned_bandwidth_agrees_with_the_full_one():
    draws, weights = cloud(2000)
    full = KernelDensity.fit(draws, weights, loo_points=2000).bandwidth
    assert KernelDensity.fit(draws, weights, loo_points=500).bandwidth == pytest.approx(full, rel=0.25)


def test_zero_weights_and_outliers_are_harmless():
    draws, weights = cloud(200)
    draws[0] = [1e4, 30.0]
    weights[0] = 0.0
    density = KernelDensity.fit(draws, weights / weights.sum())
    assert np.isfinite(density.bandwidth)
    assert len(density.centres) == 199


def test_uniform_draws_do_not_decline_at_the_bounds():
    draws = np.random.default_rng(0).uniform(-0.8, 0.5, (2000, 1))
    weights = np.full(2000, 1 / 2000)
    edge = np.array([[-0.8], [0.5]])
    mirrored = KernelDensity.fit(draws, weights, bounds=[(-0.8, 0.5)])
    np.testing.assert_allclose(mirrored.density(edge), 1 / 1.3, rtol=0.15)
    planted = KernelDensity.fit(draws, weights, bandwidth=mirrored.bandwidth)
    assert (planted.density(edge) < 0.6 / 1.3).all(), "a leaking estimate must be caught"
    mass, _ = quad(lambda x: mirrored.density(np.array([[x]]))[0], -0.8, 0.5, limit=200)
    assert mass == pytest.approx(1.0, abs=1e-3)
    np.testing.assert_array_equal(mirrored.density(np.array([[-0.81], [0.51]])), 0.0)


def test_mirroring_keeps_the_mass_of_correlated_kernels_in_two_dimensions():
    rng = np.random.default_rng(4)
    x = rng.uniform(0.0, 1.0, 60)
    draws = np.stack([x, np.clip(x + 0.1 * rng.normal(size=60), 0, 1)], axis=1)
    density = KernelDensity.fit(draws, np.full(60, 1 / 60), bounds=[(0.0, 1.0), (0.0, 1.0)])
    middle = (np.arange(120) + 0.5) / 120
    grid = np.stack(np.meshgrid(middle, middle), axis=-1).reshape(-1, 2)
    assert density.density(grid).mean() == pytest.approx(1.0, abs=2e-3)
    planted = KernelDensity.fit(draws, np.full(60, 1 / 60), bandwidth=density.bandwidth)
    assert planted.density(grid).mean() < 0.95


def test_percentile_levels_enclose_their_mass():
    """For a normal density the level of mass p is the density at the chi-square radius."""
    draws = np.random.default_rng(6).normal(size=(4000, 2))
    density = KernelDensity.fit(draws, np.full(4000, 1 / 4000))
    percentiles = [0.1, 0.5, 0.9]
    levels = density.percentile_levels(percentiles)
    assert levels[0] > levels[1] > levels[2]
    smoothed = 1 + density.bandwidth**2
    expected = np.exp(-0.5 * chi2.ppf(percentiles, 2)) / (2 * np.pi * smoothed)
    np.testing.assert_allclose(levels, expected, rtol=0.1)
    inside = density.density(draws[:2000])
    shares = [(inside > level).mean() for level in levels]
    np.testing.assert_allclose(shares, percentiles, atol=0.05)


def test_samples_follow_the_density_and_respect_bounds():
    draws = np.random.default_rng(8).uniform(0.0, 1.0, (500, 1)) ** 2
    density = KernelDensity.fit(draws, np.full(500, 1 / 500), bounds=[(0.0, 1.0)])
    sample = density.sample(2048)[:, 0]
    assert sample.min() >= 0
    assert sample.max() <= 1
    grid = np.linspace(0, 1, 400)
    cumulative = np.cumsum(density.density(grid[:, None])) / 399
    np.testing.assert_allclose((sample < 0.25).mean(), np.interp(0.25, grid, cumulative), atol=0.02)
    np.testing.assert_array_equal(sample, density.sample(2048)[:, 0])


def test_draws_without_spread_are_refused():
    with pytest.raises(NumericsError, match="spread in every direction"):
        KernelDensity.fit(np.ones((10, 1)), np.full(10, 0.1))
    with pytest.raises(InvalidInput, match="percentile"):
        KernelDensity.fit(*cloud(20)).percentile_levels([50.0])


BOUNDED = {
    "uniform": (uniform(-1e-9, 1 + 2e-9), 0.11),
    "normal, mode outside": (truncnorm(1.0 - 1e-9, 6.0 + 1e-9, loc=-0.2, scale=0.2), 0.07),
    "normal, falls to the upper bound": (truncnorm(-3.5, 0.5 + 1e-9, loc=0.9, scale=0.2), 0.08),
}
"""Densities on [0, 1] and the largest error that is allowed, as a share of their maximum."""


@pytest.mark.parametrize("name", BOUNDED)
def test_the_largest_error_of_a_density_with_bounds(name: str):
    exact, allowed = BOUNDED[name]
    draws = np.clip(exact.rvs(5000, random_state=np.random.default_rng(3)), 0.0, 1.0)[:, None]
    grid = np.linspace(0.0, 1.0, 201)
    found = KernelDensity.fit(draws, np.full(5000, 1 / 5000), bounds=[(0.0, 1.0)]).density(grid[:, None])
    truth = exact.pdf(grid)
    assert np.abs(found - truth).max() / truth.max() < allowed
    assert np.trapezoid(found, grid) == pytest.approx(1.0, abs=1e-3)


def test_mirrored_kernels_alone_miss_the_slope_at_a_bound(monkeypatch: pytest.MonkeyPatch):
    exact, allowed = BOUNDED["normal, mode outside"]
    draws = np.clip(exact.rvs(5000, random_state=np.random.default_rng(3)), 0.0, 1.0)[:, None]
    monkeypatch.setattr("strandline.posterior.kde.slope_correction", lambda points, *rest: np.zeros(len(points)))
    found = KernelDensity.fit(draws, np.full(5000, 1 / 5000), bounds=[(0.0, 1.0)]).density(np.zeros((1, 1)))
    assert abs(found[0] - exact.pdf(0.0)) / exact.pdf(0.0) > allowed


def test_the_estimate_does_not_overshoot_where_the_density_falls_to_zero_at_its_bound():
    draws = np.random.default_rng(0).beta(2.0, 3.0, 5000)[:, None]
    found = KernelDensity.fit(draws, np.full(5000, 1 / 5000), bounds=[(0.0, 1.0)]).density(np.zeros((1, 1)))
    assert found[0] < 0.1 * 1.7778, "mirrored kernels give 0.16 of the maximum"


def test_no_slope_is_taken_away_far_from_the_bounds():
    draws, weights = cloud(400, dim=1)
    free = KernelDensity.fit(draws, weights, bandwidth=0.3)
    boxed = KernelDensity.fit(draws, weights, bandwidth=0.3, bounds=[(-3000.0, 3000.0)])
    grid = np.linspace(-300.0, 300.0, 51)[:, None]
    np.testing.assert_allclose(boxed.density(grid), free.density(grid), rtol=1e-6)
