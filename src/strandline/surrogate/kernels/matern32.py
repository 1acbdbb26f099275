"""Matérn 3/2, isotropic: (1 + √3 s) exp(-√3 s)."""

import math

from strandline.surrogate.kernels.isotropic import Isotropic
from strandline.surrogate.kernels.protocol import Array, exp

__all__ = ["MATERN32"]

_SQRT3 = math.sqrt(3.0)


def _correlation(s: Array) -> Array:
    t = _SQRT3 * s
    return (1.0 + t) * exp(-t)


def _slope(s: Array) -> Array:
    return -3.0 * exp(-_SQRT3 * s)


def _slope_rate(s: Array) -> Array:
    return 3.0 * _SQRT3 * exp(-_SQRT3 * s)


MATERN32 = Isotropic("matern32", _correlation, _slope, _slope_rate)
