"""Weighted summaries: closed forms, repeated draws as oracles, and unweighted answers that must fail."""

import jax
import numpy as np
import pytest
from scipy.special import logsumexp

from strandline.errors import InvalidInput
from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import Posterior, histogram, histogram_2d, histogram_mode, systematic_indices
from strandline.priors import Uniform

SPACE = ParameterSpace((Parameter("E", Uniform(-10.0, 10.0), "Pa"), Parameter("nu", Uniform(-10.0, 10.0))))
MEAN, COVARIANCE = np.array([2.0, -1.0]), np.array([[1.0, 0.6], [0.6, 1.5]])


def importance_posterior(number: int = 20_000) -> Posterior:
    """Draws of the uniform prior, weighted to a normal posterior: the unweighted moments are the prior's."""
    draws = np.random.default_rng(0).uniform(-10, 10, (number, 2))
    centred = draws - MEAN
    log_likelihood = -0.5 * np.einsum("pi,ij,pj->p", centred, np.linalg.inv(COVARIANCE), centred)
    log_evidence = float(logsumexp(log_likelihood) - np.log(number))
    log_weights = log_likelihood - logsumexp(log_likelihood)
    return Posterior(SPACE, draws, log_weights, log_likelihood, SPACE.log_prior(draws), log_evidence)


def test_mean_covariance_and_density_are_those_of_the_normal_posterior():
    posterior = importance_posterior()
    error, sd = 1.0 / np.sqrt(posterior.ess), np.sqrt(np.diag(COVARIANCE))
    assert np.abs((posterior.mean - MEAN) / sd / error).max() < 4
    np.testing.assert_allclose(posterior.covariance, COVARIANCE, atol=8 * error)
    np.testing.assert_allclose(posterior.sd, sd, atol=8 * error)
    planted = (posterior.draws.mean(axis=0) - MEAN) / sd / error
    assert np.abs(planted).max() > 20, "an unweighted mean must be caught"
    exact = -0.5 * np.log(np.linalg.det(2 * np.pi * COVARIANCE))
    assert posterior.log_density[posterior.map_index] == pytest.approx(exact, abs=0.1)
    np.testing.assert_allclose(posterior.equally_weighted(1, 20_000).mean(axis=0), posterior.mean, atol=0.02)
    np.testing.assert_array_equal(posterior.columns(["nu", "E"]), posterior.draws[:, ::-1])


def test_integer_weights_equal_repeated_draws():
    rng = np.random.default_rng(3)
    draws, copies = rng.normal(size=(40, 2)), rng.integers(1, 6, 40)
    posterior = Posterior(SPACE, draws, np.log(copies / copies.sum()), np.zeros(40), np.zeros(40), 0.0)
    repeated = np.repeat(draws, copies, axis=0)
    np.testing.assert_allclose(posterior.mean, repeated.mean(axis=0))
    np.testing.assert_allclose(posterior.covariance, np.cov(repeated.T, ddof=0))
    levels = [0.0, 0.05, 0.5, 0.95, 1.0]
    expected = np.quantile(repeated, levels, axis=0, method="inverted_cdf")
    np.testing.assert_allclose(posterior.quantiles(levels), expected)
    assert not np.allclose(np.quantile(draws, levels, axis=0, method="inverted_cdf"), expected)


def test_zero_weights_do_not_count_and_the_map_counts_the_prior_and_survives_nan():
    log_weights = np.array([-np.inf, np.log(0.5), np.log(0.5)])
    draws = np.arange(8.0).reshape(4, 2)
    posterior = Posterior(SPACE, draws[:3], log_weights, np.zeros(3), np.zeros(3), 0.0)
    assert posterior.ess == pytest.approx(2.0)
    np.testing.assert_allclose(posterior.mean, draws[1:3].mean(axis=0))
    likelihood, prior = np.array([0.0, 3.0, np.nan, 2.9]), np.array([0.0, -1.0, 9.0, 0.0])
    posterior = Posterior(SPACE, draws, np.log(np.full(4, 0.25)), likelihood, prior, 0.0)
    assert posterior.map_index == 3
    np.testing.assert_array_equal(posterior.map_estimate, draws[3])


def test_systematic_resampling_copies_in_proportion_without_bias():
    weights = np.array([0.5, 0.25, 0.0, 0.25])
    draws = np.array([[0.0, 0], [1, 0], [2, 0], [3, 0]])
    with np.errstate(divide="ignore"):
        posterior = Posterior(SPACE, draws, np.log(weights), np.zeros(4), np.zeros(4), 0.0)
    for seed in (7, np.random.default_rng(7), jax.random.key(7), jax.random.PRNGKey(7)):
        counts = np.bincount(posterior.equally_weighted(seed, 400)[:, 0].astype(int), minlength=4)
        assert np.abs(counts - 400 * weights).max() <= 1
        assert counts[2] == 0
    weights, rng = np.array([0.33, 0.02, 0.65]), np.random.default_rng(0)
    counts = sum(np.bincount(systematic_indices(weights, 2, rng), minlength=3) for _ in range(2000))
    np.testing.assert_allclose(counts / 4000, weights, atol=0.02)


def test_what_is_refused():
    good, zeros = importance_posterior(10), np.zeros(10)
    line = ParameterSpace(SPACE.parameters[:1])
    cases = [
        (lambda: Posterior(SPACE, good.draws, good.log_weights + 1.0, zeros, zeros, 0.0), "logsumexp"),
        (lambda: Posterior(SPACE, np.full((10, 2), np.nan), good.log_weights, zeros, zeros, 0.0), "design box"),
        (lambda: Posterior(line, good.draws, good.log_weights, zeros, zeros, 0.0), "particle"),
        (lambda: good.equally_weighted(0, 0), "at least 1"),
        (lambda: good.columns(["rho"]), "rho"),
        (lambda: histogram(np.array([0.0, 2.0]), np.array([0.5, 0.5]), bounds=(0.0, 1.0)), "left out"),
    ]
    for call, words in cases:
        with pytest.raises(InvalidInput, match=words):
            call()


def test_histograms_carry_all_weight():
    posterior, box = importance_posterior(2000), (-10.0, 10.0)
    one = histogram(posterior.draws[:, 0], posterior.weights, bounds=box, bins=40)
    assert one.mass.sum() == pytest.approx(1.0)
    assert one.density @ np.diff(one.edges) == pytest.approx(1.0)
    assert one.mass @ (0.5 * (one.edges[1:] + one.edges[:-1])) == pytest.approx(posterior.mean[0], abs=0.1)
    two = histogram_2d(posterior.draws, posterior.weights, bounds=(box, box), bins=40)
    np.testing.assert_allclose(two.mass.sum(axis=1), one.mass)
    assert (two.density * np.outer(np.diff(two.x_edges), np.diff(two.y_edges))).sum() == pytest.approx(1.0)
    assert histogram(np.full(3, 2.0), np.full(3, 1 / 3)).mass.sum() == pytest.approx(1.0), "a constant has one bin"


def test_the_mode_of_a_histogram_is_its_fullest_bin_and_not_the_joint_mode():
    """A thin high spike holds less mass than a broad hill: integrating the nuisance moves the mode (Remark 8)."""
    draws = np.array([[0.05, 0.05], [0.05, 0.05], [0.95, 0.55], [1.0, 1.0]])
    mode = histogram_mode(draws, np.array([0.1, 0.1, 0.7, 0.1]), bounds=[(0.0, 1.0), (0.0, 1.0)], bins=10)
    np.testing.assert_allclose(mode, [0.95, 0.55])
    rng = np.random.default_rng(0)
    hill, spike = rng.normal([2.0, 0.0], [0.5, 3.0], (6000, 2)), rng.normal([-4.0, 0.0], [0.5, 0.01], (2000, 2))
    draws = np.clip(np.concatenate([hill, spike]), -10, 10)
    density = np.where(np.arange(8000) < 6000, 0.0, 5.0)
    posterior = Posterior(SPACE, draws, np.full(8000, -np.log(8000)), density, np.zeros(8000), 0.0)
    assert posterior.map_estimate[0] < 0
    mode = histogram_mode(posterior.columns(["E"]), posterior.weights, bounds=[(-10.0, 10.0)])
    assert mode[0] == pytest.approx(2.0, abs=0.7)
