"""
From the prior to the posterior
===============================

Tempered Sequential Monte Carlo raises the likelihood's exponent so far at each step that enough particles remain
effective. Here it samples a curved density with independent coordinates at the start.
"""

import jax
import jax.numpy as jnp

import strandline as sl
from strandline.report.plots import plot_tempering


def log_likelihood(x):
    """Return log L of a banana."""
    return -0.5 * ((x[:, 0] - 1.0) ** 2 + (x[:, 1] - x[:, 0] ** 2) ** 2) / 0.05


def log_prior(x):
    """Return the log density of a standard normal distribution, up to a constant."""
    return -0.5 * jnp.sum(x**2, axis=1)


start, chain = jax.random.split(jax.random.key(1))
found = sl.sample(chain, log_likelihood, log_prior, jax.random.normal(start, (2000, 2)), settings=sl.SMCSettings())
steps = found.steps
plot_tempering([s.temperature for s in steps], [s.ess for s in steps], [s.acceptance for s in steps], particles=2000)
