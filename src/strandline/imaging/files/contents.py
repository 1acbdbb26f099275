"""What a reader returns: a picture file that is open, its frames not yet in memory."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Shaped

from strandline.imaging.pixel_size import PixelSize
from strandline.readers.problems import refused

__all__ = ["MOST_PIXELS", "PictureFile", "require_pixels"]

MOST_PIXELS = 400_000_000
"""Most pixels of a picture, and most voxels of a stack: 3.2 GB in double precision."""


def _nothing() -> None:
    return


@dataclass(frozen=True, eq=False)
class PictureFile:
    """A picture file that is open.

    Args:
        shape: Rows and columns of a frame.
        load: Function that returns a frame by its number, shape (row, column) or (row, column, channel), with the
            channels grey and alpha; red, green and blue; or these and alpha.
        axes: Names and lengths of the axes along which the frames lie, slowest first.
        size: Size of a pixel, if the file states it.
        notes: Sentences that say what was taken from where.
        close: Function that closes the file.
    """

    shape: tuple[int, int]
    load: Callable[[int], Shaped[np.ndarray, "row column *channel"]]
    axes: tuple[tuple[str, int], ...] = ()
    size: PixelSize | None = None
    notes: tuple[str, ...] = ()
    close: Callable[[], None] = _nothing

    @property
    def frames(self) -> int:
        """Number of frames."""
        return math.prod(length for _, length in self.axes)


def require_pixels(name: str, *sizes: int) -> None:
    """Refuse a picture or a stack without pixels, or with too many, before memory is taken for it.

    Args:
        name: Name of the file in messages.
        sizes: Numbers of rows and columns, and of anything else that is read at once.

    Raises:
        Unreadable: The product is 0 or above `MOST_PIXELS`.
    """
    if 0 < math.prod(sizes) <= MOST_PIXELS and min(sizes) > 0:
        return
    raise refused(
        f"{name} has no size that can be read",
        " × ".join(map(str, sizes)),
        f"from 1 to {MOST_PIXELS // 10**6} million pixels",
        "Crop the picture to the interface, or look at what writes the file.",
    )
