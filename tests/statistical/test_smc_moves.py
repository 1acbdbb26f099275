"""The moves leave π_γ invariant: independent draws of it stay independent draws of it."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from strandline.smc import metropolis
from strandline.testing import densities

NUMBER, STEPS, LIMIT = 40_000, 5, 4.5
GAUSSIAN = densities.gaussian(np.array([1.0, -2.0]), np.array([[1.0, 0.6], [0.6, 2.0]]))
RATE = np.array([3.0, 0.7])
CORNER = densities.linear_exponential(RATE)


def draw_gaussian(gamma, rng):
    return rng.multivariate_normal(GAUSSIAN.mean, GAUSSIAN.covariance / gamma, NUMBER)


def draw_corner(gamma, rng):
    rate = gamma * RATE
    return -np.log1p(rng.random((NUMBER, 2)) * np.expm1(-rate)) / rate


def worst_z(x, exact_mean, exact_covariance):
    """Return the largest |z| of means and central second moments of independent draws."""
    deviation = x - exact_mean
    products = deviation[:, [0, 0, 1]] * deviation[:, [0, 1, 1]] - exact_covariance[[0, 0, 1], [0, 1, 1]]
    columns = np.concatenate([deviation, products], axis=1)
    return np.abs(columns.mean(axis=0) / (columns.std(axis=0) / np.sqrt(len(x)))).max()


def boundless(x):
    return 0 * x[:, 0]


@partial(jax.jit, static_argnames="target")
def move(key, x, temperature, factor, *, target):
    likelihood, prior = target[0](x), target[1](x)
    return metropolis(key, x, likelihood, prior, target=target, temperature=temperature, factor=factor, steps=STEPS)


def moved(target, draw, gamma, *, used=None, log_prior=None):
    x = jnp.asarray(draw(gamma, np.random.default_rng(5)))
    factor = jnp.asarray(np.linalg.cholesky(target.covariance))
    functions = target.log_likelihood, log_prior or target.log_prior
    end = move(jax.random.key(2), x, jnp.asarray(used or gamma), factor, target=functions)
    assert float(end.acceptance) > 0.1
    assert float(jnp.mean(jnp.any(end.positions != x, axis=1))) > 0.5
    return np.asarray(end.positions)


@pytest.mark.parametrize("gamma", [0.3, 0.6, 1.0])
def test_a_gaussian_stays(gamma):
    x = moved(GAUSSIAN, draw_gaussian, gamma)
    assert worst_z(x, GAUSSIAN.mean, GAUSSIAN.covariance / gamma) < LIMIT


@pytest.mark.parametrize("gamma", [0.3, 1.0])
def test_a_density_cut_by_its_prior_stays(gamma):
    exact = densities.linear_exponential(gamma * RATE)
    assert worst_z(moved(CORNER, draw_corner, gamma), exact.mean, exact.covariance) < LIMIT


def test_another_temperature_in_the_acceptance_fails():
    x = moved(GAUSSIAN, draw_gaussian, 0.5, used=1.0)
    assert worst_z(x, GAUSSIAN.mean, GAUSSIAN.covariance / 0.5) > 2 * LIMIT


def test_moves_that_forget_the_support_fail():
    x = moved(CORNER, draw_corner, 1.0, log_prior=boundless)
    assert worst_z(x, CORNER.mean, CORNER.covariance) > 2 * LIMIT


def test_moves_that_clip_to_the_support_fail():
    x = np.clip(moved(CORNER, draw_corner, 1.0, log_prior=boundless), 0, 1)
    assert worst_z(x, CORNER.mean, CORNER.covariance) > 2 * LIMIT
