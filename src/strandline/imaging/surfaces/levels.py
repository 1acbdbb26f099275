"""Grey values of a stack: smoothed, and the two levels between which the surface lies."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32
from scipy.ndimage import gaussian_filter

__all__ = ["Field", "field_of", "two_levels"]

_BINS = 256
_EVERY = 1 << 20
"""Voxels from which the two levels and the noise come; of larger stacks every so many are taken."""
_NORMAL = 0.6745
"""Median of the size of a standard normal number."""
_CLEAN, _SMOOTHEST = 5.0, 2.0
"""Contrast over noise from which a Gaussian of 1 is enough; largest Gaussian, in sides of a voxel."""
_TRUNCATE = 3.0


@dataclass(frozen=True, eq=False)
class Field:
    """The smoothed grey values of a stack.

    Lengths are in sides of a cube with a voxel's volume, so that a voxel need not be a cube.

    Args:
        values: Smoothed grey values, shape (z, row, column).
        raw: Grey values as read, of the same shape.
        stretch: Size of a voxel along x, y and z.
        sigma: Standard deviation of the Gaussian that smoothed them.
    """

    values: Float32[np.ndarray, "z row column"]
    raw: Float[np.ndarray, "z row column"]
    stretch: Float[np.ndarray, " 3"]
    sigma: float

    @property
    def extent(self) -> Float[np.ndarray, " 3"]:
        """Place (x, y, z) of the last voxel; that of the first is 0."""
        return np.asarray((np.array(self.values.shape[::-1]) - 1) * self.stretch)


def field_of(
    values: Float[np.ndarray, "z row column"], stretch: Float[np.ndarray, " 3"], *, smooth: float | None
) -> Field:
    """Return the smoothed grey values.

    Args:
        values: Grey values.
        stretch: Size of a voxel along x, y and z.
        smooth: Standard deviation of the Gaussian, in sides of a voxel; by default 1, and up to 2 in a noisy stack.
    """
    single = values.astype(np.float32)
    sigma = 1.0 if smooth is None else smooth
    smoothed = _blurred(single, sigma, stretch)
    if smooth is None:
        low, high = two_levels(smoothed)
        wanted = min(_CLEAN * _noise(single) / max(high - low, 1e-30), _SMOOTHEST)
        if wanted > sigma:
            smoothed, sigma = _blurred(smoothed, math.sqrt(wanted**2 - sigma**2), stretch), wanted
    return Field(smoothed, values, stretch, sigma)


def two_levels(values: Float32[np.ndarray, "z row column"]) -> tuple[float, float]:
    """Return the median grey values of the dark and of the bright part, told apart by Otsu's threshold (1979)."""
    some = _some(values)
    counts, edges = np.histogram(some, _BINS)
    centres = 0.5 * (edges[1:] + edges[:-1])
    below = np.cumsum(counts)
    above = below[-1] - below
    sums = np.cumsum(counts * centres)
    with np.errstate(invalid="ignore", divide="ignore"):
        between = below * above * (sums / below - (sums[-1] - sums) / above) ** 2
    threshold = edges[1 + int(np.nanargmax(np.nan_to_num(between[:-1])))]
    dark, bright = some[some <= threshold], some[some > threshold]
    if not dark.size or not bright.size:
        return float(some.min()), float(some.max())
    return float(np.median(dark)), float(np.median(bright))


def _noise(values: Float32[np.ndarray, "z row column"]) -> float:
    """Return the standard deviation of white noise, from differences of neighbours along a row."""
    step = max(1, round((values.size / _EVERY) ** (1 / 2)))
    difference = np.diff(values[::step, ::step], axis=2)
    return float(np.median(np.abs(difference))) / (_NORMAL * math.sqrt(2))


def _some(values: Float32[np.ndarray, "z row column"]) -> Float32[np.ndarray, " some"]:
    step = max(1, round((values.size / _EVERY) ** (1 / 3)))
    return values[::step, ::step, ::step].ravel()


def _blurred(
    values: Float32[np.ndarray, "z row column"], sigma: float, stretch: Float[np.ndarray, " 3"]
) -> Float32[np.ndarray, "z row column"]:
    return np.asarray(gaussian_filter(values, sigma / stretch[::-1], mode="nearest", truncate=_TRUNCATE))
