"""What is told of a posterior, against closed forms: moments, histograms, approximations, bands of interfaces."""

import jax
import numpy as np
import pytest
from scipy.special import logsumexp, ndtri

from strandline.foundations import InvalidInput, NumericsError
from strandline.interface import Interface
from strandline.parameters import LogNormal, Normal, Parameter, ParameterSpace, ScaledBeta, Uniform
from strandline.posterior import GaussianApproximation, Posterior, laplace, log_prior_hessian, prior_conflicts
from strandline.posterior.posterior import (
    histogram,
    histogram_mode,
    interface_band,
    normal_offsets,
    observed_offsets,
)

SPACE = ParameterSpace((Parameter("E", Uniform(-10.0, 10.0), "Pa"), Parameter("nu", Uniform(-10.0, 10.0))))
MEAN, COVARIANCE = np.array([2.0, -1.0]), np.array([[1.0, 0.6], [0.6, 1.5]])


def importance_posterior(number=20_000):
    """Draws of the uniform prior, weighted to a normal posterior: the unweighted moments are the prior's."""
    draws = np.random.default_rng(0).uniform(-10, 10, (number, 2))
    centred = draws - MEAN
    log_likelihood = -0.5 * np.einsum("pi,ij,pj->p", centred, np.linalg.inv(COVARIANCE), centred)
    log_evidence = float(logsumexp(log_likelihood) - np.log(number))
    log_weights = log_likelihood - logsumexp(log_likelihood)
    return Posterior(SPACE, draws, log_weights, log_likelihood, SPACE.log_prior(draws), log_evidence)


def test_the_data_contradict_a_prior():
    """A false alarm in one of 100 inputs, however good the data are; a wrong prior is nearly always found."""
    space = ParameterSpace(
        (Parameter("E", Normal(100.0, 15.0), "Pa", (0.0, 250.0)), Parameter("nu", Uniform(0.0, 1.0)))
    )
    levels, random = (np.arange(500) + 0.5) / 500, np.random.default_rng(1)

    def alarm(truth, noise):
        shrink = 15**2 / (15**2 + noise**2)
        mean, sd = 100 + shrink * (truth + noise * random.standard_normal() - 100), noise * np.sqrt(shrink)
        draws = np.stack([mean + sd * ndtri(levels), np.full(500, 0.999)], axis=1)
        zeros = np.zeros(500)
        found = list(prior_conflicts(Posterior(space, draws, zeros - np.log(500), zeros, zeros, 0.0)))
        assert all("contradict the prior of E, Normal(mean=100.0, sd=15.0): " in one for one in found)
        return len(found)

    for noise in (0.5, 15, 40):
        assert 1 <= sum(alarm(random.normal(100, 15), noise) for _ in range(600)) <= 15
    assert sum(alarm(100 + 4 * 15, 2) for _ in range(50)) == 50


def plain(draws, weights, log_likelihood=None, log_prior=None):
    """Return a posterior whose densities do not matter but where they are given."""
    zeros = np.zeros(len(draws))
    likelihood, prior = (zeros if one is None else np.array(one) for one in (log_likelihood, log_prior))
    with np.errstate(divide="ignore"):
        return Posterior(SPACE, draws, np.log(weights), likelihood, prior, 0.0)


def test_the_density_is_that_of_the_normal_posterior_and_integer_weights_equal_repeated_draws():
    posterior = importance_posterior()
    exact = -0.5 * np.log(np.linalg.det(2 * np.pi * COVARIANCE))
    assert posterior.log_density[posterior.map_index] == pytest.approx(exact, abs=0.1)
    np.testing.assert_array_equal(posterior.columns(["nu", "E"]), posterior.draws[:, ::-1])
    rng = np.random.default_rng(3)
    draws, copies = rng.normal(size=(40, 2)), rng.integers(1, 6, 40)
    posterior, repeated = plain(draws, copies / copies.sum()), np.repeat(draws, copies, axis=0)
    np.testing.assert_allclose(posterior.mean, repeated.mean(axis=0))
    np.testing.assert_allclose(posterior.covariance, np.cov(repeated.T, ddof=0))
    levels = [0.0, 0.05, 0.5, 0.95, 1.0]
    expected = np.quantile(repeated, levels, axis=0, method="inverted_cdf")
    np.testing.assert_allclose(posterior.quantiles(levels), expected)
    np.testing.assert_array_equal(posterior.quantiles(0.5), posterior.quantiles([0.5])[0])
    assert not np.allclose(np.quantile(draws, levels, axis=0, method="inverted_cdf"), expected)


def test_zero_weights_do_not_count_the_map_counts_the_prior_and_resampling_copies_in_proportion():
    draws = np.arange(8.0).reshape(4, 2)
    posterior = plain(draws[:3], np.array([0.0, 0.5, 0.5]))
    assert posterior.ess == pytest.approx(2.0)
    np.testing.assert_allclose(posterior.mean, draws[1:3].mean(axis=0))
    posterior = plain(draws, np.full(4, 0.25), [0.0, 3.0, np.nan, 2.9], [0.0, -1.0, 9.0, 0.0])
    assert posterior.map_index == 3
    np.testing.assert_array_equal(posterior.map_estimate, draws[3])
    weights = np.array([0.5, 0.25, 0.0, 0.25])
    posterior = plain(draws, weights)
    for seed in (7, np.random.default_rng(7), jax.random.key(7), jax.random.PRNGKey(7)):
        counts = np.bincount(posterior.equally_weighted(seed, 400)[:, 0].astype(int) // 2, minlength=4)
        assert np.abs(counts - 400 * weights).max() <= 1
        assert counts[2] == 0


def test_histograms_carry_all_weight_and_their_mode_is_the_fullest_bin():
    posterior, box = importance_posterior(2000), (-10.0, 10.0)
    one = histogram(posterior.draws[:, 0], posterior.weights, bounds=box, bins=40)
    assert one.mass.sum() == pytest.approx(1.0)
    assert one.density @ np.diff(one.edges) == pytest.approx(1.0)
    assert one.mass @ (0.5 * (one.edges[1:] + one.edges[:-1])) == pytest.approx(posterior.mean[0], abs=0.1)
    draws = np.array([[0.05, 0.05], [0.05, 0.05], [0.95, 0.55], [1.0, 1.0]])
    mode = histogram_mode(draws, np.array([0.1, 0.1, 0.7, 0.1]), bounds=[(0.0, 1.0), (0.0, 1.0)], bins=10)
    np.testing.assert_allclose(mode, [0.95, 0.55])


def test_a_posterior_has_one_line_and_a_table():
    def shown(dim):
        space = ParameterSpace(tuple(Parameter(f"k<{i}", Uniform(0.0, 1000.0), "mm^2/s") for i in range(dim)))
        draws, zeros = 400.0 + 30.0 * np.random.default_rng(1).standard_normal((1000, dim)), np.zeros(1000)
        return Posterior(space, draws, zeros - np.log(1000), zeros, zeros, 0.0)

    assert repr(shown(1)).replace("\u00a0", " ") == "<Posterior k<0 = 398 ± 30 mm² s⁻¹; 1000 particles, ESS 1000>"
    line, table = repr(shown(12)), shown(3)._repr_html_()
    assert ", and 4 more;" in line
    assert "\n" not in line
    assert (table.count("<tr>"), "k&lt;0" in table) == (4, True)


SCALED = np.array([[150.0**2, 30.0, 1.0], [30.0, 0.09, 0.01], [1.0, 0.01, 4.0]])
GAUSSIAN = GaussianApproximation(np.array([400.0, 0.1, 80.0]), SCALED)
DRAWS = np.random.default_rng(1).multivariate_normal(GAUSSIAN.mean, SCALED, 20_000)


def test_each_radius_encloses_its_share_and_an_ellipse_that_of_the_plane():
    for p in (0.1, 0.5, 0.9):
        inside = (GAUSSIAN.radius(DRAWS) < GAUSSIAN.percentile_radius(p)).mean()
        assert inside == pytest.approx(p, abs=4 * np.sqrt(p * (1 - p) / len(DRAWS)))
    curve = GAUSSIAN.ellipse(0.9, pair=(2, 0))
    plane = GaussianApproximation(GAUSSIAN.mean[[2, 0]], SCALED[np.ix_([2, 0], [2, 0])])
    np.testing.assert_allclose(plane.radius(curve), np.sqrt(-2 * np.log(0.1)))
    planted = plane.radius(DRAWS[:, [2, 0]]) < GAUSSIAN.percentile_radius(0.9)
    assert planted.mean() > 0.93, "the radius of three inputs used in the plane must be caught"


def test_laplace_of_a_gaussian_is_that_gaussian_and_maxima_are_told_from_saddles_in_any_unit():
    found = laplace(-np.linalg.inv(SCALED), GAUSSIAN.mean)
    assert found.definite
    np.testing.assert_allclose(found.gaussian.covariance, SCALED, rtol=1e-9)
    saddle = laplace(np.array([[-1.0, 2.0], [2.0, -1.0]]), np.zeros(2))
    assert saddle.covariance is None
    for hessian in (np.diag([-1.0, 1.0]), np.diag([-1.0, 0.0]), -np.ones((2, 2)), np.zeros((2, 2))):
        assert not laplace(hessian, np.zeros(2)).definite
    units = np.diag([1e9, 1e-9])
    for correlation, definite in ((0.9, True), (1.1, False)):
        hessian = -units @ np.array([[1.0, correlation], [correlation, 1.0]]) @ units
        assert laplace(hessian, np.zeros(2)).definite is definite


PRIORS = ParameterSpace(
    (
        Parameter("E", LogNormal(5.86, 0.4), "Pa", (100.0, 800.0)),
        Parameter("nu", ScaledBeta(43 / 13, 22 / 13, -0.8, 0.5)),
        Parameter("V", Normal(80.0, 9.0), "mm²/s", (20.0, 110.0)),
        Parameter("k", Uniform(0.0, 1.0)),
    )
)


def test_the_hessian_of_the_prior_agrees_with_finite_differences_and_closed_forms():
    x, step = np.array([320.0, 0.15, 75.0, 0.5]), np.diag([0.3, 3e-4, 0.05, 1e-3])
    exact, differences = log_prior_hessian(PRIORS, x), np.empty((4, 4))
    for i, j in np.ndindex(4, 4):
        corners = [s * t * PRIORS.log_prior(x + s * step[i] + t * step[j]) for s in (1, -1) for t in (1, -1)]
        differences[i, j] = sum(corners) / (4 * step[i, i] * step[j, j])
    np.testing.assert_allclose(exact, differences, rtol=1e-4, atol=1e-8)
    assert exact[0, 0] == pytest.approx((1 + (np.log(320.0) - 6.86) / 0.16) / 320**2)
    np.testing.assert_array_equal(exact, np.diag(np.diag(exact)))


def test_weights_that_rounding_left_unnormalised_are_normalised():
    """Log-likelihoods of -1e12, of an observation far from all runs, leave 1e-4."""
    good, zeros = importance_posterior(10), np.zeros(10)
    again = Posterior(SPACE, good.draws, good.log_weights + 1e-4, zeros, zeros, 0.0)
    np.testing.assert_allclose(again.weights, good.weights, rtol=1e-12)


def test_what_is_refused():
    good, zeros, pair = importance_posterior(10), np.zeros(10), np.zeros(2)
    line = ParameterSpace(SPACE.parameters[:1])
    for call, error, words in (
        (lambda: Posterior(SPACE, good.draws, good.log_weights + 1.0, zeros, zeros, 0.0), InvalidInput, "logsumexp"),
        (lambda: plain(np.array([[0.5, 0.5], [np.nan, 0.5]]), np.full(2, 0.5)), InvalidInput, "particle 1 of the post"),
        (lambda: Posterior(line, good.draws, good.log_weights, zeros, zeros, 0.0), InvalidInput, "particle"),
        (lambda: good.equally_weighted(0, 0), InvalidInput, "at least 1"),
        (lambda: histogram(np.array([0.0, 2.0]), np.full(2, 0.5), bounds=(0.0, 1.0)), InvalidInput, "left out"),
        (lambda: GAUSSIAN.percentile_radius(10.0), InvalidInput, r"0\.1"),
        (lambda: laplace(np.array([[-1.0, 2.0], [2.0, -1.0]]), pair).gaussian, NumericsError, "not negative definite"),
        (lambda: laplace(np.array([[-1.0, 0.5], [0.0, -1.0]]), pair), InvalidInput, "finite differences"),
        (lambda: log_prior_hessian(PRIORS, np.array([50.0, 0.15, 75.0, 0.5])), InvalidInput, "inside the support"),
    ):
        with pytest.raises(error, match=words):
            call()


LINE = Interface.polyline(np.array([[0.0, 0.0], [1.0, 0.0], [3.0, 0.0]]))
ANGLES = np.linspace(0, 2 * np.pi, 90, endpoint=False)
ROUND = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)
CIRCLE = Interface.polyline(ROUND, closed=True)
"""Run through anticlockwise: its inside is to the left."""


def test_bands_are_those_of_each_coordinate_and_offsets_to_the_closest_place_are_positive_to_the_left():
    values = np.random.default_rng(9).normal(size=(41, 5, 3))
    band, ordered = interface_band(values), np.sort(values, axis=0)
    for found, row in ((band.low, 2), (band.median, 20), (band.high, 38)):
        np.testing.assert_allclose(found, ordered[row])
    found = normal_offsets(LINE.points + np.array([[[0.2, 0.1]], [[0.0, -0.3]]]), LINE)
    np.testing.assert_allclose(found.arc_length, [0, 1, 3])
    np.testing.assert_allclose(found.offset, [[0.1] * 3, [-0.3] * 3], atol=1e-15)
    found = normal_offsets(np.stack([1.1 * ROUND]), CIRCLE)
    np.testing.assert_allclose(found.offset, -0.1)
    np.testing.assert_allclose(found.arc_length, 2 * np.sin(np.pi / 90) * np.arange(90))
    observed = Interface.polyline(np.array([[3.0, -0.4], [2.0, 0.2], [0.5, 0.0], [-0.3, 0.4]]))
    found = observed_offsets(observed, LINE)
    np.testing.assert_allclose(found.arc_length, [0.0, 0.5, 2.0, 3.0])
    np.testing.assert_allclose(found.offset, [0.5, 0.0, 0.2, -0.4])
