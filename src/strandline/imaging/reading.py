"""How to read a picture: the options of `observation.image` that concern the file."""

import dataclasses
from dataclasses import dataclass
from typing import Any, Literal

from strandline.foundations import imported
from strandline.readers import TO_MM, number, refused, unfit

UNITS = TO_MM | {"nm": 1e-6}
EXAMPLE_OF_SIZE = "{x: 6.0, y: 4.0, unit: um} or {size: 6.0, unit: um}"
SMALLEST, LARGEST = 1e-12, 1e9
"""Sizes, mm, that a picture may have; beyond them, areas and their squares overflow."""
SAME = 0.01
"""Largest relative difference between the sizes that the study and a header state."""
SCALES = ("intensity", "amplitude", "log10", "dB", "sRGB")
"""What the numbers in the file are: the intensity, its root, its logarithm, 10 log10 of it, or coded for a screen."""
CHANNELS = ("grey", "red", "green", "blue")
INDICES = (1.0, 4.0)
"""Smallest and largest refractive index that is accepted."""


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
            raise unfit("x and y, or size", lengths or None, EXAMPLE_OF_SIZE)

    @property
    def in_mm(self) -> PixelSize:
        """The size in mm."""
        mm, square = UNITS[self.unit], self.size or 0.0
        return PixelSize(mm * (self.x or square), mm * (self.y or square), None if self.z is None else mm * self.z)


def agreed(study: PixelSize | None, header: PixelSize | None, name: str) -> PixelSize:
    """Return the size of a pixel that the study or the header of the file states; they may differ by 1 %."""
    if study is None and header is None:
        raise refused(
            f"{name} does not state the size of a pixel",
            None,
            "the size in the study; the dots per inch of a picture are not its scale",
            "Add e.g. `pixel: {size: 6.0, unit: um}` to the picture.",
        )
    if study is None or header is None:
        return study or header  # type: ignore[return-value]
    for mine, its in zip((study.x, study.y, study.z), (header.x, header.y, header.z), strict=True):
        if mine is not None and its is not None and abs(mine - its) > SAME * its:
            raise refused(
                f"pixel size of {name}: the study and the file disagree",
                f"{study} in the study, {header} from {header.source}",
                "the same size in both, to 1 %",
                "Correct `pixel`, or remove it to take the size from the file.",
            )
    return PixelSize(study.x, study.y, study.z if study.z is not None else header.z, study.source)


@dataclass(frozen=True)
class PictureReading:
    """How to read a picture.

    Args:
        page: Frame to read, from 0; by default the first.
        average: Whether to average all frames of the file, which show one state.
        pixel: Size of a pixel; needed unless the file's header states it.
        index: Refractive index that divides the size along y, as depth in OCT is optical path; by default 1.
        scale: What the numbers in the file are, one of `SCALES`; by default intensity.
        dataset: Name of the array in an HDF5 or MATLAB file.
        channel: Colour to take, one of `CHANNELS`; by default colours are converted to grey.
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
            low, high = INDICES
            expected = f"a refractive index from {low:g} to {high:g}, e.g. 1.333 for water"
            number(self.index, "index", expected, low, high)
        if self.reader is not None and not callable(imported(self.reader, "reader")):
            raise unfit("reader", self.reader, "a function (path, how, name) -> PictureFile")

    @property
    def given(self) -> dict[str, Any]:
        """The options that differ from their defaults."""
        return {f.name: v for f in dataclasses.fields(self) if (v := getattr(self, f.name)) != f.default}
