"""Product of one-dimensional Matérn 3/2: Π_d (1 + t_d) exp(-t_d), t_d = √3 |x_d - x'_d| / l_d."""

import math

from strandline.surrogate.kernels.product import Product
from strandline.surrogate.kernels.protocol import Array

__all__ = ["MATERN32_PRODUCT"]


def _polynomial(t: Array) -> Array:
    return 1.0 + t


def _decline(t: Array) -> Array:
    return 1.0 / (1.0 + t)


def _curvature(t: Array) -> Array:
    return (t - 1.0) / (1.0 + t)


MATERN32_PRODUCT = Product("matern32_product", math.sqrt(3.0), _polynomial, _decline, _curvature)
