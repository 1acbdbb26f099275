"""Adaptive importance sampling against closed forms, with planted bugs."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, multivariate_t

from strandline.calibration import importance_sampler as module
from strandline.calibration.importance_sampler import Pool, StudentMixture, effective_size, fitted, followed
from strandline.design import sobol
from strandline.posterior.weighted import Weighted

LogDensity = Callable[[np.ndarray], np.ndarray]
MEAN = np.array([0.4, 0.55])
COVARIANCE = np.array([[0.0004, 0.0003], [0.0003, 0.0009]])


def gaussian(mean: np.ndarray, covariance: np.ndarray) -> LogDensity:
    return lambda x: np.asarray(multivariate_normal(mean, covariance).logpdf(x), float).reshape(len(x))


def tried(
    target: LogDensity, dim: int = 2, *, seed: int = 1, number: int = 1024, enough: float = 400.0
) -> Weighted | None:
    """Sample a target on the unit cube."""

    def log_densities(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        inside = ((x >= 0) & (x <= 1)).all(axis=1)
        return np.where(inside, 0.0, -np.inf), np.where(inside, target(x), -np.inf)

    x = sobol(number, dim, scramble=seed)
    pool = Pool(x, np.zeros(number), np.zeros(number), target(x), number)
    found = followed(pool, log_densities, np.random.default_rng(seed), enough=enough)
    return None if found is None else found.weighted


def sampled(target: LogDensity, dim: int = 2, *, seed: int = 1, number: int = 1024) -> Weighted:
    found = tried(target, dim, seed=seed, number=number)
    assert found is not None
    return found


def scores(seeds: int) -> np.ndarray:
    """Return errors of means and of standard deviations in units of what their effective sizes allow."""
    out, sd = [], np.sqrt(np.diag(COVARIANCE))
    for seed in range(seeds):
        found = sampled(gaussian(MEAN, COVARIANCE), seed=seed)
        size = 1 / np.sum(found.weights**2)
        out.append([*(found.mean - MEAN) / sd * np.sqrt(size), *(found.sd / sd - 1) * np.sqrt(2 * size)])
    return np.array(out)


def test_moments_of_a_narrow_gaussian(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: draws of the fitted mixtures weighted as if they came from the prior."""
    found = scores(12)
    assert np.abs(found.mean(axis=0)).max() < 1.0
    assert np.sqrt(np.mean(found**2)) < 1.5
    np.testing.assert_array_equal(scores(1), found[:1])
    wrong = property(lambda pool: pool.log_target - logsumexp(pool.log_target))
    monkeypatch.setattr(Pool, "log_weights", wrong)
    assert np.abs(scores(4)[:, 2:].mean(axis=0)).max() > 3.0


def test_two_modes_keep_their_shares() -> None:
    """Modes 20 standard deviations apart, the narrower one with 30 % of the mass."""

    def target(x: np.ndarray) -> np.ndarray:
        parts = [np.log(0.3) + gaussian(np.array([0.25, 0.3]), 0.01**2 * np.eye(2))(x)]
        parts += [np.log(0.7) + gaussian(np.array([0.7, 0.6]), 0.025**2 * np.eye(2))(x)]
        return np.asarray(logsumexp(parts, axis=0))

    found = [sampled(target, seed=seed) for seed in range(8)]
    shares = [one.weights[one.draws[:, 0] < 0.45].sum() for one in found]
    assert np.mean(shares) == pytest.approx(0.3, abs=0.03)
    assert np.std(shares) < 0.06


def test_seven_inputs() -> None:
    mean, sd = np.full(7, 0.45), np.linspace(0.02, 0.08, 7)
    found = sampled(gaussian(mean, np.diag(sd**2)), 7, number=4096)
    assert np.abs((found.mean - mean) / sd).max() < 0.3
    assert np.abs(found.sd / sd - 1).max() < 0.25


def test_what_is_wide_needs_no_round_and_what_is_not_reached_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    assert tried(gaussian(MEAN, COVARIANCE), enough=1e7) is None
    monkeypatch.setattr(module, "fitted", None)
    assert len(sampled(gaussian(np.full(2, 0.5), 0.2**2 * np.eye(2))).draws) == 1024


def test_the_first_sample_may_have_weights_and_gaps() -> None:
    """A point that stands for two, and one that is left out: as if the sample were written out."""
    x, target = np.array([[0.1], [0.2], [0.3]]), np.array([0.5, 1.0, -0.5])
    weighted = Pool(x, np.array([np.log(2.0), 0.0, -np.inf]), np.zeros(3), target, 3)
    plain = Pool(x[[0, 0, 1]], np.zeros(3), np.zeros(3), target[[0, 0, 1]], 3)
    one, other = np.exp(weighted.log_weights), np.exp(plain.log_weights)
    np.testing.assert_allclose(one, [other[0] + other[1], other[2], 0.0], rtol=1e-12)


def test_the_density_is_that_of_student_and_draws_have_it() -> None:
    """The mean of any function over q, weighted by p/q, is its mean over p."""
    factors = np.linalg.cholesky(np.array([[[0.02, 0.01], [0.01, 0.05]], [[0.3, 0.0], [0.0, 0.1]]]))
    found = StudentMixture(np.array([0.25, 0.75]), np.array([[0.0, 1.0], [2.0, -1.0]]), factors)
    x, parts = np.random.default_rng(4).normal(size=(50, 2)), zip(found.shares, found.means, factors, strict=True)
    exact = sum(p * multivariate_t(m, L @ L.T, df=module.FREEDOM).pdf(x) for p, m, L in parts)
    np.testing.assert_allclose(np.exp(found.log_density(x)), exact, rtol=1e-10)
    x = found.draw(40000, np.random.default_rng(6))
    ratio = np.exp(gaussian(np.array([1.0, 0.0]), np.eye(2))(x) - found.log_density(x))
    assert ratio.mean() == pytest.approx(1.0, abs=5 * ratio.std() / np.sqrt(len(x)))


def test_a_fit_finds_both_clusters() -> None:
    random = np.random.default_rng(8)
    x = np.concatenate([random.normal(0.0, 0.1, (600, 2)), random.normal(5.0, 0.2, (400, 2))])
    found = fitted(x, np.zeros(1000), random)
    assert found.shares[(found.means < 2.5).all(axis=1)].sum() == pytest.approx(0.6, abs=0.02)


def test_the_effective_size_is_that_of_equal_weights() -> None:
    assert effective_size(np.array([0.3, 0.3, 0.3, -np.inf])) == pytest.approx(3.0)
    assert effective_size(np.array([-2000.0, -2000.0])) == pytest.approx(2.0)  # far below what exp can hold
    assert effective_size(np.full(3, -np.inf)) == 0.0
