"""Pictures as arrays, with the size of their pixels and where everything came from; stacks; files that are open."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Shaped

from strandline.imaging.reading import PixelSize
from strandline.readers import refused, unfit

MOST_PIXELS = 400_000_000
"""Most pixels of a picture, and most voxels of a stack: 3.2 GB in double precision."""


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture, linear in intensity.

    Pixel coordinates are (x, y) = (column, row), y points down, and the centre of the top left pixel is (0, 0).

    Args:
        values: Intensity of each pixel, shape (row, column), finite.
        pixel: Size of a pixel along x and along y, mm; the refractive index has divided y.
        name: Name of the file in messages.
        sha256: Checksum of the file's bytes; of several files, that of their checksums one after the other.
        notes: Sentences that say what was taken from where.
        frames: Number of frames whose mean it is.

    Raises:
        InvalidInput: A pixel that is not finite, a picture without pixels, or pixels without a size.
    """

    values: Float[np.ndarray, "row column"]
    pixel: tuple[float, float]
    name: str
    sha256: str
    notes: tuple[str, ...] = ()
    frames: int = 1

    def __post_init__(self) -> None:
        _require_sound(self.values, self.pixel, self.name)

    def __repr__(self) -> str:
        rows, columns = self.values.shape
        x, y = (1e3 * size for size in self.pixel)
        return f"Picture({self.name}, {columns} × {rows} pixels of {x:.4g} × {y:.4g} µm)"


@dataclass(frozen=True, eq=False)
class Stack:
    """Pictures of parallel planes, linear in intensity.

    Args:
        values: Intensity of each voxel, shape (z, row, column), finite.
        voxel: Size of a voxel along x (column), y (row) and z (plane), mm; the refractive index has divided y.
        name: Name of the file in messages.
        sha256: Checksum, as that of a picture.
        notes: Sentences that say what was taken from where.

    Raises:
        InvalidInput: A voxel that is not finite, a stack without voxels, or voxels without a size.
    """

    values: Float[np.ndarray, "z row column"]
    voxel: tuple[float, float, float]
    name: str
    sha256: str
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        _require_sound(self.values, self.voxel, self.name)

    def __repr__(self) -> str:
        planes, rows, columns = self.values.shape
        sizes = " × ".join(f"{1e3 * size:.4g}" for size in self.voxel)
        return f"Stack({self.name}, {columns} × {rows} × {planes} voxels of {sizes} µm)"


def _require_sound(values: Float[np.ndarray, "..."], sizes: tuple[float, ...], name: str) -> None:
    if not values.size:
        raise unfit(f"{name} is empty", values.shape, "at least one pixel", "Look at the file.")
    if not all(math.isfinite(size) and size > 0 for size in sizes):
        raise unfit(f"pixel size of {name}", sizes, "finite lengths above 0, in mm", "Correct the pixel size.")
    missing = values.size - int(np.isfinite(values).sum())
    if missing:
        raise unfit(
            f"{name} has pixels that are not finite",
            f"{missing} of {values.size}",
            "a finite number in each pixel",
            "Crop the picture, or fill these pixels and leave their region out of the edge.",
        )


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
    close: Callable[[], object] = lambda: None

    @property
    def frames(self) -> int:
        """Number of frames."""
        return math.prod(length for _, length in self.axes)


def require_pixels(name: str, *sizes: int) -> None:
    """Refuse a picture or a stack without pixels, or with more than `MOST_PIXELS`, before memory is taken for it."""
    if 0 < math.prod(sizes) <= MOST_PIXELS and min(sizes) > 0:
        return
    raise refused(
        f"{name} has no size that can be read",
        " × ".join(map(str, sizes)),
        f"from 1 to {MOST_PIXELS // 10**6} million pixels",
        "Crop the picture to the interface, or look at what writes the file.",
    )
