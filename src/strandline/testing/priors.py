"""Conformance suite for priors: what any `strandline.parameters.Prior` must do."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from strandline.foundations import use_double
from strandline.parameters import Prior
from strandline.testing import checks_of, require_parts

LEVELS = np.linspace(0.001, 0.999, 999)


def check_it_has_all_parts(prior: Prior) -> None:
    """It satisfies the protocol."""
    require_parts(prior, Prior)
    low, high = prior.support
    assert low < high, "the support is empty"


def check_quantiles_invert_the_distribution(prior: Prior) -> None:
    """The quantile of the cumulative probability is the point itself."""
    points = np.asarray(prior.quantile(LEVELS))
    assert (np.diff(points) > 0).all(), "quantiles do not grow with their level"
    assert np.allclose(prior.cdf(points), LEVELS, atol=1e-9), "cdf(quantile(p)) is not p"


def check_the_density_is_the_slope_of_the_distribution(prior: Prior) -> None:
    """Integrating the density between quantiles gives the probability between them."""
    low, high = (float(prior.quantile(np.array(p))) for p in (0.01, 0.99))
    nodes, weights = np.polynomial.legendre.leggauss(40)
    edges = np.linspace(low, high, 101)
    half = 0.5 * np.diff(edges)
    points = (edges[:-1] + half)[:, None] + half[:, None] * nodes
    mass = float((np.exp(np.asarray(prior.log_density(points))) * weights * half[:, None]).sum())
    assert abs(mass - 0.98) < 1e-6, f"the density integrates to {mass:g} between its 1 % and 99 % quantiles, not 0.98"


def check_nothing_lies_outside_the_support(prior: Prior) -> None:
    """The density is zero outside the support."""
    low, high = prior.support
    outside = np.array([x for x in (low - 1.0, high + 1.0) if np.isfinite(x)])
    assert (np.asarray(prior.log_density(outside)) == -np.inf).all(), "the density outside the support is not zero"


def check_it_compiles(prior: Prior) -> None:
    """The log density is the same under `jax.jit`."""
    use_double()
    points = np.asarray(prior.quantile(LEVELS))
    compiled = jax.jit(prior.log_density)(jnp.asarray(points))
    assert np.allclose(compiled, prior.log_density(points), atol=1e-9), "JAX gives another log density than NumPy"


CHECKS: dict[str, Callable[[Prior], None]] = checks_of(globals())
