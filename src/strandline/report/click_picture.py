"""A picture as the page of clicks shows it: 8 bits, reduced if it is large."""

import io
import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from strandline.errors import InvalidInput

__all__ = ["MOST_PIXELS", "Shown", "shown"]

MOST_PIXELS, LONGEST_SIDE = 6_000_000, 8192
"""Largest picture that is shown as it is, in pixels."""
ENDS = (0.2, 99.8)
"""Percentiles of the values that become black and white."""
SAMPLED = 1_000_000
"""Number of values from which percentiles are taken."""
DARK = 0.1
"""Median below which a picture is brightened, as intensities of coherent light need it."""
BRIGHTEST_POWER = 0.25


class Shown(NamedTuple):
    """A picture for the screen.

    Args:
        png: The picture as a PNG file.
        factor: Number of pixels of the original, in each direction, that one pixel stands for.
    """

    png: bytes
    factor: int


def shown(values: Float[np.ndarray, "row column"], *, most_pixels: int = MOST_PIXELS) -> Shown:
    """Return a picture for the screen; values that are not finite are black.

    Args:
        values: Grey values.
        most_pixels: Largest picture that is shown as it is, in pixels.

    Raises:
        InvalidInput: There is no finite value.
    """
    from PIL import Image

    height, width = values.shape
    factor = _factor(height, width, most_pixels)
    grey = np.round(255 * _reduced(_shaded(values), factor)).astype(np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(np.asarray(grey, dtype=np.uint8)).save(buffer, format="png")
    return Shown(buffer.getvalue(), factor)


def _factor(height: int, width: int, most_pixels: int) -> int:
    """Return the smallest factor that makes the picture small enough."""
    factor = max(1, math.ceil(max(height, width) / LONGEST_SIDE))
    while math.ceil(height / factor) * math.ceil(width / factor) > most_pixels:
        factor += 1
    return factor


def _shaded(values: Float[np.ndarray, "row column"]) -> Float[np.ndarray, "row column"]:
    """Return brightness from 0 to 1, single precision."""
    sample = values[:: max(1, math.isqrt(values.size // SAMPLED)), :: max(1, math.isqrt(values.size // SAMPLED))]
    finite = sample[np.isfinite(sample)]
    if finite.size == 0:
        raise InvalidInput(
            "values of the picture",
            value=f"{values.shape[1]} × {values.shape[0]} px without a finite value",
            expected="numbers",
            remedy="Look at the picture, its page and its scale.",
        )
    low, middle, high = np.percentile(finite, [ENDS[0], 50, ENDS[1]])
    if not high > low:
        low, high = float(finite.min()), float(finite.max())
    range_ = (high - low) or 1.0
    brightness = np.clip((values - low) / range_, 0.0, 1.0).astype(np.float32)
    median = (middle - low) / range_
    if 0 < median < DARK:
        brightness **= max(BRIGHTEST_POWER, math.log(3 * DARK) / math.log(median))
    return np.asarray(np.nan_to_num(brightness, copy=False))


def _reduced(brightness: Float[np.ndarray, "row column"], factor: int) -> Float[np.ndarray, "block_row block_column"]:
    """Return means of blocks; the picture is continued to whole blocks by its last row and column."""
    if factor == 1:
        return brightness
    height, width = brightness.shape
    whole = np.pad(brightness, ((0, -height % factor), (0, -width % factor)), mode="edge")
    blocks = whole.reshape(whole.shape[0] // factor, factor, whole.shape[1] // factor, factor)
    return np.asarray(blocks.mean(axis=(1, 3)))
