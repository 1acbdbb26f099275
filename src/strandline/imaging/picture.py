"""Pictures and stacks as arrays, files that are open, and how to read them: the options of `observation.image`."""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Shaped

from strandline.foundations import imported, number, unfit
from strandline.readers import TO_MM, refused

UNITS = TO_MM | {"nm": 1e-6}
SMALLEST, LARGEST = 1e-12, 1e9
"""Sizes, mm, that a picture may have; beyond them, areas and their squares overflow."""
SAME = 0.01
"""Largest relative difference between the sizes that the study and a header state."""


@dataclass(frozen=True)
class PixelSize:
    """Size of a pixel as stated, before the refractive index divides y.

    Args:
        x: Size along a row, mm.
        y: Size along a column, mm.
        z: Distance of the planes of a stack, mm, if stated.
        source: Who states it, e.g. ``the study``.

    Raises:
        InvalidInput: A size that no picture has.
    """

    x: float
    y: float
    z: float | None = None
    source: str = "the study"

    def __post_init__(self) -> None:
        for size in (self.x, self.y, self.z):
            if size is not None and not SMALLEST <= size <= LARGEST:
                expected = f"a length from {SMALLEST:g} to {LARGEST:g} mm"
                raise unfit(f"pixel size from {self.source}", f"{size:g} mm", expected, "Correct the size or its unit.")

    def __str__(self) -> str:
        known = [size for size in (self.x, self.y, self.z) if size is not None]
        return " × ".join(f"{1e3 * size:.6g}" for size in known) + " µm"


@dataclass(frozen=True)
class StatedSize:
    """The size of a pixel or voxel as a study states it: `size`, or x and y; and z of a stack.

    Args:
        unit: Unit of the lengths.
        size: Size of a square pixel.
        x: Size along a row.
        y: Size along a column.
        z: Distance of the planes of a stack.

    Raises:
        InvalidInput: Not one of `size` and x with y, or a length that is not above 0.
    """

    unit: Literal["nm", "um", "µm", "mm", "m"]
    size: float | None = None
    x: float | None = None
    y: float | None = None
    z: float | None = None

    def __post_init__(self) -> None:
        lengths = {name: value for name in ("size", "x", "y", "z") if (value := getattr(self, name)) is not None}
        for name, value in lengths.items():
            number(value, name, "a length above 0", low=5e-324)
        if lengths.keys() - {"z"} not in ({"size"}, {"x", "y"}):
            expected = "{x: 6.0, y: 4.0, unit: um} or {size: 6.0, unit: um}"
            raise unfit("x and y, or size", lengths or None, expected)

    @property
    def in_mm(self) -> PixelSize:
        """The size in mm."""
        mm, square = UNITS[self.unit], self.size or 0.0
        return PixelSize(mm * (self.x or square), mm * (self.y or square), None if self.z is None else mm * self.z)


def agreed(study: PixelSize | None, header: PixelSize | None, name: str) -> PixelSize:
    """Return the size of a pixel that the study or the header of the file states; they may differ by 1 %."""
    if study is None and header is None:
        expected = "the size in the study; the dots per inch of a picture are not its scale"
        remedy = "Add e.g. `pixel: {size: 6.0, unit: um}` to the picture."
        raise refused(f"{name} does not state the size of a pixel", None, expected, remedy)
    if study is None or header is None:
        return study or header  # type: ignore[return-value]
    for mine, its in zip((study.x, study.y, study.z), (header.x, header.y, header.z), strict=True):
        if mine is not None and its is not None and abs(mine - its) > SAME * its:
            found, expected = f"{study} in the study, {header} from {header.source}", "the same size in both, to 1 %"
            remedy = "Correct `pixel`, or remove it to take the size from the file."
            raise refused(f"pixel size of {name}: the study and the file disagree", found, expected, remedy)
    return PixelSize(study.x, study.y, study.z if study.z is not None else header.z, study.source)


@dataclass(frozen=True)
class PictureReading:
    """How to read a picture.

    Args:
        page: Frame to read, from 0; by default the first.
        average: Whether to average all frames of the file, which show one state.
        pixel: Size of a pixel; needed unless the file's header states it.
        index: Refractive index that divides the size along y, as depth in OCT is optical path; by default 1.
        scale: What the numbers in the file are: by default the intensity; or its root, its logarithm, 10 log10 of it,
            or coded for a screen.
        dataset: Name of the array in an HDF5 or MATLAB file.
        channel: Colour to take; by default colours are converted to grey.
        reader: Function that reads the file, ``module:name``; by default the suffix determines it.

    Raises:
        InvalidInput: An option that cannot be used.
    """

    page: int | None = None
    average: bool = False
    pixel: PixelSize | None = None
    index: float | None = None
    scale: Literal["intensity", "amplitude", "log10", "dB", "sRGB"] | None = None
    dataset: str | None = None
    channel: Literal["grey", "red", "green", "blue"] | None = None
    reader: str | None = None

    def __post_init__(self) -> None:
        if self.average and self.page is not None:
            raise unfit("page and average", "both", "one of the two", "Remove one of them.")
        if self.page is not None and self.page < 0:
            raise unfit("page", self.page, "the number of a frame, from 0")
        if self.index is not None:
            number(self.index, "index", "a refractive index from 1 to 4, e.g. 1.333 for water", 1.0, 4.0)
        if self.reader is not None and not callable(imported(self.reader, "reader")):
            raise unfit("reader", self.reader, "a function (path, how, name) -> PictureFile")

    @property
    def given(self) -> dict[str, Any]:
        """The options that differ from their defaults."""
        return {f.name: v for f in dataclasses.fields(self) if (v := getattr(self, f.name)) != f.default}


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
        expected = "a finite number in each pixel"
        remedy = "Crop the picture, or fill these pixels and leave their region out of the edge."
        raise unfit(f"{name} has pixels that are not finite", f"{missing} of {values.size}", expected, remedy)


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
    expected = f"from 1 to {MOST_PIXELS // 10**6} million pixels"
    remedy = "Crop the picture to the interface, or look at what writes the file."
    raise refused(f"{name} has no size that can be read", " × ".join(map(str, sizes)), expected, remedy)
