"""The moves leave π_γ invariant: independent draws of it stay independent draws of it."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from strandline.smc import metropolis
from strandline.testing import densities

NUMBER, STEPS, LIMIT = 40_000, 5, 4.5
GAUSSIAN = densities.gaussian(np.array([1.0, -2.0]), np.array([[1.0, 0.6], [0.6, 2.0]]))
RATE = np.array([3.0, 0.7])
CORNER = densities.linear_exponential(RATE)


def draw_gaussian(gamma: float) -> np.ndarray:
    return np.random.default_rng(5).multivariate_normal(GAUSSIAN.mean, GAUSSIAN.covariance / gamma, NUMBER)


def draw_corner(gamma: float) -> np.ndarray:
    rate = gamma * RATE
    return np.asarray(-np.log1p(np.random.default_rng(5).random((NUMBER, 2)) * np.expm1(-rate)) / rate)


def worst_z(x: np.ndarray, mean: np.ndarray, covariance: np.ndarray) -> float:
    """Return the largest |z| of means and central second moments of independent draws."""
    deviation = x - mean
    products = deviation[:, [0, 0, 1]] * deviation[:, [0, 1, 1]] - covariance[[0, 0, 1], [0, 1, 1]]
    columns = np.concatenate([deviation, products], axis=1)
    return float(np.abs(columns.mean(axis=0) / (columns.std(axis=0) / np.sqrt(len(x)))).max())


@partial(jax.jit, static_argnames="target")
def move(key: Any, x: Any, temperature: Any, factor: Any, *, target: Any) -> Any:
    likelihood, prior = target[0](x), target[1](x)
    return metropolis(key, x, likelihood, prior, target=target, temperature=temperature, factor=factor, steps=STEPS)


def moved(target: Any, draws: np.ndarray, gamma: float, log_prior: Any = None) -> np.ndarray:
    factor = jnp.asarray(np.linalg.cholesky(target.covariance))
    functions = target.log_likelihood, log_prior or target.log_prior
    end = move(jax.random.key(2), jnp.asarray(draws), jnp.asarray(gamma), factor, target=functions)
    assert float(end.acceptance) > 0.1
    assert float(jnp.mean(jnp.any(end.positions != draws, axis=1))) > 0.5
    return np.asarray(end.positions)


def test_a_gaussian_stays() -> None:
    """Planted: another temperature in the acceptance."""
    for gamma in (0.3, 1.0):
        x = moved(GAUSSIAN, draw_gaussian(gamma), gamma)
        assert worst_z(x, GAUSSIAN.mean, GAUSSIAN.covariance / gamma) < LIMIT
    x = moved(GAUSSIAN, draw_gaussian(0.5), 1.0)
    assert worst_z(x, GAUSSIAN.mean, GAUSSIAN.covariance / 0.5) > 2 * LIMIT


def test_a_density_cut_by_its_prior_stays() -> None:
    """Planted: moves that forget the support, or clip to it."""
    for gamma in (0.3, 1.0):
        exact = densities.linear_exponential(gamma * RATE)
        assert worst_z(moved(CORNER, draw_corner(gamma), gamma), exact.mean, exact.covariance) < LIMIT
    x = moved(CORNER, draw_corner(1.0), 1.0, log_prior=lambda x: 0 * x[:, 0])
    for wrong in (x, np.clip(x, 0, 1)):
        assert worst_z(wrong, CORNER.mean, CORNER.covariance) > 2 * LIMIT
