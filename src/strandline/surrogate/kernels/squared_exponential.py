"""Squared exponential, isotropic: exp(-s²/2); also called Gaussian or RBF.

Its samples are analytic, and its covariance is far worse conditioned than a Matérn one with the same length: the
eigenvalues fall faster than any power. If the factorisation fails in floating point, `NumericsError` is raised, and
the optimiser of the evidence treats such lengths as a wall.
"""

from strandline.surrogate.kernels.isotropic import Isotropic
from strandline.surrogate.kernels.protocol import Array, exp

__all__ = ["SQUARED_EXPONENTIAL"]


def _correlation(s: Array) -> Array:
    return exp(-0.5 * s * s)


def _slope(s: Array) -> Array:
    return -exp(-0.5 * s * s)


def _slope_rate(s: Array) -> Array:
    return s * exp(-0.5 * s * s)


SQUARED_EXPONENTIAL = Isotropic("squared_exponential", _correlation, _slope, _slope_rate)
