"""Product of one-dimensional Matérn 5/2: Π_d (1 + t_d + t_d²/3) exp(-t_d), t_d = √5 |x_d - x'_d| / l_d."""

import math

from strandline.surrogate.kernels.product import Product
from strandline.surrogate.kernels.protocol import Array

__all__ = ["MATERN52_PRODUCT"]

_THIRD = 1.0 / 3.0  # NumPy divides several times slower than it multiplies


def _polynomial(t: Array) -> Array:
    return 1.0 + t * (1.0 + _THIRD * t)


def _decline(t: Array) -> Array:
    return (1.0 + t) / (3.0 + t * (3.0 + t))


def _curvature(t: Array) -> Array:
    return (t * (t - 1.0) - 1.0) / (3.0 + t * (3.0 + t))


MATERN52_PRODUCT = Product("matern52_product", math.sqrt(5.0), _polynomial, _decline, _curvature)
