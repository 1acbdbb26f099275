"""A picture as an array, with the size of its pixels and where everything came from; a stack of pictures likewise."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.errors import InvalidInput

__all__ = ["Picture", "Stack"]


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
        raise InvalidInput(
            f"{name} is empty", value=values.shape, expected="at least one pixel", remedy="Look at the file."
        )
    if not all(math.isfinite(size) and size > 0 for size in sizes):
        expected = "finite lengths above 0, in mm"
        raise InvalidInput(f"pixel size of {name}", value=sizes, expected=expected, remedy="Correct the pixel size.")
    missing = values.size - int(np.isfinite(values).sum())
    if missing:
        raise InvalidInput(
            f"{name} has pixels that are not finite",
            value=f"{missing} of {values.size}",
            expected="a finite number in each pixel",
            remedy="Crop the picture, or fill these pixels and leave their region out of the edge.",
        )
