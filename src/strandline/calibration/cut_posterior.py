"""The cut reading of the posterior under uncertainty: one conditional posterior for each value of the nuisance inputs.

It samples p(x | θ, Y) of a surrogate for values θ that represent p(θ) and pools the draws; see
`strandline.posterior.under_uncertainty` for what the result means.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from strandline.calibration.problem import Settings
from strandline.parameters import ParameterSpace
from strandline.posterior import Cut, Posterior, Reading, UnderUncertainty, nuisance_values, pooled
from strandline.posterior.quadrature import QuadratureResult, integrate
from strandline.smc import BatchedLogDensity, is_on_host, sample_each

__all__ = ["LARGEST_DIM", "cut_by_quadrature", "under_uncertainty"]

ZETA = 0.5
"""Share of the effective sample size that a tempering step keeps: enough for moments."""
FEWEST_PARTICLES = 250
"""Fewest particles for each value of the nuisance inputs: 150 gave errors of 5 % of a standard deviation."""
STREAM = 2
"""Keeps these random numbers apart from the two streams of the joint reading."""
LARGEST_DIM = 3
"""Largest number of inputs, including nuisance inputs, for which posteriors are also integrated directly."""


def under_uncertainty(posterior: Posterior, log_likelihood: BatchedLogDensity, settings: Settings) -> UnderUncertainty:
    """Return both readings of the posterior of the calibrated inputs: joint and cut.

    For the cut reading, p(x | θ, Y) is sampled for values θ that represent p(θ), and the draws are pooled.

    Args:
        posterior: Posterior of all inputs, some of them nuisance.
        log_likelihood: Log-likelihood of points (…, dim).
        settings: Settings of the joint posterior; tempering steps may be longer here.
    """
    space = posterior.space
    theta, calibrated = nuisance_values(space, settings.nuisance_values), space.calibrated_space
    start, chain = jax.random.split(jax.random.fold_in(jax.random.key(settings.seed), STREAM))
    each = max(FEWEST_PARTICLES, -(-settings.particles // len(theta)))
    uniform = jax.random.uniform(start, (len(theta) * each, calibrated.dim), dtype=float)
    initial = calibrated.prior_quantiles(np.asarray(uniform)).reshape(len(theta), each, -1)
    longer = replace(settings.smc, zeta=min(ZETA, settings.smc.zeta))
    given = _given(space, log_likelihood)
    found = sample_each(chain, given, calibrated.log_prior, initial, theta, settings=longer)
    return UnderUncertainty(Reading(posterior), pooled(space, theta, found))


def cut_by_quadrature(log_likelihood: BatchedLogDensity, cut: Cut) -> tuple[QuadratureResult, ...] | None:
    """Integrate p(x | θ, Y) directly for each θ of a cut reading; None for more than three inputs."""
    space = cut.extended.space
    if space.dim > LARGEST_DIM:
        return None
    calibrated, given = space.calibrated_space, _given(space, log_likelihood)
    found = given.of_one_value if is_on_host(given) else jax.jit(given)

    def log_density(x: Float[np.ndarray, "point x"], theta: Float[np.ndarray, " nuisance"]) -> Any:
        return np.asarray(found(x, theta)) + calibrated.log_prior(x)

    return tuple(integrate(partial(log_density, theta=theta), calibrated.low, calibrated.high) for theta in cut.values)


@dataclass(frozen=True)
class _GivenOnHost:
    """log L for NumPy arrays of calibrated inputs and of as many nuisance inputs."""

    log_likelihood: Callable[[Float[np.ndarray, "point dim"]], Float[np.ndarray, " point"]]
    order: tuple[int, ...]
    on_host = True

    def __call__(
        self, x: Float[np.ndarray, "point x"], theta: Float[np.ndarray, "point nuisance"]
    ) -> Float[np.ndarray, " point"]:
        return self.log_likelihood(np.ascontiguousarray(np.concatenate([x, theta], axis=1)[:, self.order]))

    def of_one_value(
        self, x: Float[np.ndarray, "point x"], theta: Float[np.ndarray, " nuisance"]
    ) -> Float[np.ndarray, " point"]:
        """Return log L with the same nuisance inputs at all points."""
        return self(x, np.tile(theta, (len(x), 1)))


def _given(space: ParameterSpace, log_likelihood: Any) -> Any:
    """Return log L as a function of the calibrated inputs and of one value of the nuisance inputs."""
    order = np.argsort([*space.calibrated, *space.nuisance])
    if is_on_host(log_likelihood):
        return _GivenOnHost(log_likelihood, tuple(order.tolist()))

    def given(x: Float[jax.Array, "particle x"], theta: Float[jax.Array, " nuisance"]) -> Float[jax.Array, " particle"]:
        fixed = jnp.broadcast_to(theta, (len(x), len(theta)))
        values: jax.Array = log_likelihood(jnp.concatenate([x, fixed], axis=1)[:, order])
        return values

    return given
