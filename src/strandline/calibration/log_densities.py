"""Log densities of a prior and a posterior at many points at once, -∞ outside the prior."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float

from strandline.parameters import ParameterSpace

__all__ = ["Densities", "only_inside", "prior_and_posterior"]

Points = Float[np.ndarray, "point dim"]
Values = Float[np.ndarray, " point"]
Densities = Callable[[Points], tuple[Values, Values]]
"""Function that returns the log densities of the prior and of the posterior, each of shape (point,)."""


def only_inside(inside: Callable[[Points], Bool[np.ndarray, " point"]], densities: Densities) -> Densities:
    """Return densities that are evaluated inside the prior only, and are -∞ elsewhere.

    Args:
        inside: Function that says which points lie inside.
        densities: Log densities of points that do.
    """

    def log_densities(x: Points) -> tuple[Values, Values]:
        """Return the log densities of the prior and of the posterior, -∞ outside."""
        first, target = np.full(len(x), -np.inf), np.full(len(x), -np.inf)
        some = inside(x)
        if some.any():
            first[some], target[some] = densities(x[some])
        return first, target

    return log_densities


def prior_and_posterior(space: ParameterSpace, log_likelihood: Callable[[Points], Values]) -> Densities:
    """Return the log densities of the prior, and of likelihood times prior.

    Args:
        space: Inputs with their priors.
        log_likelihood: Log-likelihood; it is called only where the prior's density is above 0.
    """

    def log_prior(x: Points) -> Values:
        """Return the log density of the prior, -∞ outside the box."""
        out = np.full(len(x), -np.inf)
        box = ((x >= space.low) & (x <= space.high)).all(axis=1)
        out[box] = np.asarray(space.log_prior(x[box]))
        return out

    def both(x: Points) -> tuple[Values, Values]:
        """Return the log densities of points where the prior's density is above 0."""
        first = log_prior(x)
        return first, first + log_likelihood(x)

    return only_inside(lambda x: np.isfinite(log_prior(x)), both)
