"""Comparison of the sizes of two interfaces, which reveals a wrong unit."""

import math

import numpy as np

from strandline.interface import Interface

__all__ = ["LARGEST_RATIO", "extent", "extent_ratio", "unit_mistake"]

LARGEST_RATIO = 10.0
"""An observed interface this many times larger or smaller than the model's is taken to have another unit."""

_FACTORS = {1: ("mm", "cm"), 3: ("µm", "mm"), 6: ("µm", "m")}
"""Decimal logarithm of a factor → two units that differ by this factor."""


def extent(interface: Interface) -> float:
    """Return the largest side of the box around an interface, mm."""
    return float(np.ptp(interface.points, axis=0).max())


def extent_ratio(observed: Interface, simulated: Interface) -> float:
    """Return the extent of the observed interface divided by that of the simulated one."""
    return extent(observed) / extent(simulated)


def unit_mistake(ratio: float) -> str:
    """Return a clause, "perhaps …", on the unit that was probably mistaken; empty if the extents are similar.

    Args:
        ratio: The extent of the observed interface divided by that of the simulated one.
    """
    power = abs(math.log10(ratio))
    if power < math.log10(LARGEST_RATIO) * (1 - 1e-9):
        return ""
    nearest = min(_FACTORS, key=lambda k: abs(k - power))
    small, large = _FACTORS[nearest]
    observed, simulated = (small, large) if ratio > 1 else (large, small)
    return (
        f"perhaps the observation is in {observed} and was read in {simulated}, or the model's output the other way "
        f"round ({small} and {large} differ by a factor of {10**nearest:g})"
    )
