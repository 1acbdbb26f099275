"""Isotropic correlation functions c(s) of the scaled distance s = r / l.

The covariance is k(r) = σ0² c(r / l). Everything that a Gaussian process needs follows from three functions of s:

- c(s), the correlation;
- g(s) = c'(s) / s, finite at s = 0: ∇c = g(s) (x - x') / l², and ∂c/∂log l = -s² g(s);
- g'(s): ∇∇c = g(s) I / l² + g'(s) / s · (x - x')(x - x')ᵀ / l⁴.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from strandline.errors import InvalidInput

__all__ = ["KERNELS", "Kernel", "kernel_named"]

Array = Any  # a NumPy or a JAX array of any shape

_SQRT3 = math.sqrt(3.0)


@dataclass(frozen=True)
class Kernel:
    """A twice differentiable isotropic correlation; functions of s = r / l on NumPy and JAX arrays of any shape.

    Args:
        name: the key in `KERNELS`.
        correlation: c(s).
        slope: g(s) = c'(s) / s.
        slope_rate: g'(s).
    """

    name: str
    correlation: Callable[[Array], Array]
    slope: Callable[[Array], Array]
    slope_rate: Callable[[Array], Array]

    def by_log_length(self, s: Array) -> Array:
        """Return ∂c / ∂log l."""
        return -s * s * self.slope(s)


def _matern32(s: Array) -> Array:
    """Return (1 + √3 s) exp(-√3 s)."""
    t = _SQRT3 * s
    return (1.0 + t) * _exp(-t)


def _matern32_slope(s: Array) -> Array:
    return -3.0 * _exp(-_SQRT3 * s)


def _matern32_slope_rate(s: Array) -> Array:
    return 3.0 * _SQRT3 * _exp(-_SQRT3 * s)


def _exp(x: Array) -> Array:
    xp = x.__array_namespace__() if hasattr(x, "__array_namespace__") else np
    return xp.exp(x)


KERNELS: dict[str, Kernel] = {
    "matern32": Kernel("matern32", _matern32, _matern32_slope, _matern32_slope_rate),
}


def kernel_named(name: str) -> Kernel:
    """Return the kernel of that name.

    Raises:
        InvalidInput: no such kernel.
    """
    if name not in KERNELS:
        raise InvalidInput(
            "name of the kernel",
            value=name,
            expected=f"one of {', '.join(KERNELS)}",
            remedy="Choose one of these or add a line to strandline.surrogate.kernels.KERNELS.",
        )
    return KERNELS[name]
