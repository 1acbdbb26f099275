"""Matérn 5/2, isotropic: (1 + t + t²/3) exp(-t), t = √5 s."""

import math

from strandline.surrogate.kernels.isotropic import Isotropic
from strandline.surrogate.kernels.protocol import Array, exp

__all__ = ["MATERN52"]

_SQRT5 = math.sqrt(5.0)


def _correlation(s: Array) -> Array:
    t = _SQRT5 * s
    return (1.0 + t * (1.0 + t / 3.0)) * exp(-t)


def _slope(s: Array) -> Array:
    t = _SQRT5 * s
    return -5.0 / 3.0 * (1.0 + t) * exp(-t)


def _slope_rate(s: Array) -> Array:
    t = _SQRT5 * s
    return 5.0 / 3.0 * _SQRT5 * t * exp(-t)


MATERN52 = Isotropic("matern52", _correlation, _slope, _slope_rate)
