"""Random errors at the points of an interface, correlated along it."""

import math
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.interface.interface import Interface

__all__ = ["correlated", "summed_length"]

_WAVES = 1000
"""Waves that make up the fields of errors on a surface."""


def summed_length(length: Any, spacing: Any) -> Any:
    """Return (h/2) coth(h/2ℓ), half of h times the sum of exp(-|k|h/ℓ) over all integers k; arrays of any shape.

    It takes the place of the correlation length ℓ of errors at points h apart: nearly ℓ if h is small, h/2 if ℓ is 0.
    """
    with np.errstate(divide="ignore"):
        return 0.5 * spacing / np.tanh(np.divide(0.5 * spacing, length))


def correlated(
    interface: Interface, length: float, number: int, random: np.random.Generator
) -> Float[np.ndarray, "draw point"]:
    """Return standard normal numbers at the points, correlated as exp(-t/ℓ) at distance t, one row per draw.

    On a polyline t is measured along it. On a closed one the first and the last point are correlated only along the
    way round.

    Args:
        interface: The interface.
        length: Correlation length ℓ, mm; 0 for independent points.
        number: Number of draws.
        random: Generator of the random numbers.
    """
    if length > 0 and interface.dim == 3:
        return _over(interface, length, number, random)
    white = random.standard_normal((number, len(interface.points)))
    return white if length == 0 else _along(interface, length, white)


def _along(
    polyline: Interface, length: float, white: Float[np.ndarray, "draw point"]
) -> Float[np.ndarray, "draw point"]:
    keep = np.exp(-polyline.lengths / length)
    new = np.sqrt(1 - keep**2)
    corners = np.append(polyline.cells[:, 0], polyline.cells[-1, 1])
    out, value = np.empty_like(white), white[:, 0]
    out[:, corners[0]] = value
    for k, corner in enumerate(corners[1:]):
        if corner == corners[0]:
            break
        value = keep[k] * value + new[k] * white[:, k + 1]
        out[:, corner] = value
    return out


def _over(
    surface: Interface, length: float, number: int, random: np.random.Generator
) -> Float[np.ndarray, "draw point"]:
    """Return sums of random waves (Rahimi and Recht 2007); the draws share the waves, not their amplitudes."""
    waves = random.standard_normal((_WAVES, 3)) / (length * np.abs(random.standard_normal((_WAVES, 1))))
    phases = surface.points @ waves.T
    both = np.hstack([np.cos(phases), np.sin(phases)])
    return np.asarray(random.standard_normal((number, 2 * _WAVES)) @ both.T / math.sqrt(_WAVES))
