"""How to read a picture: the options of `observation.image` that concern the file."""

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from strandline.readers.checked import keys_of, number, unfit, word
from strandline.readers.contents import refused
from strandline.readers.options import TO_MM
from strandline.registry import imported

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
EXAMPLE = "{pixel: {x: 6.0, y: 4.0, unit: um}, scale: intensity}"


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

    @classmethod
    def from_options(cls, options: object, place: str) -> "PixelSize":
        """Return the size that a study file gives at `place`.

        Raises:
            InvalidInput: An option is missing, unknown, or not a length above 0.
        """
        given = keys_of(options, ("x", "y", "z", "size", "unit"), place, EXAMPLE_OF_SIZE)
        if given.get("unit") is None:
            raise unfit(f"{place}.unit", None, f"one of {', '.join(UNITS)}", f"Add `unit: um` to {place}.")
        factor = UNITS[word(given["unit"], UNITS, f"{place}.unit")]
        if given.keys() - {"unit", "z"} not in ({"size"}, {"x", "y"}):
            raise unfit(place, dict(given), f"x and y, or size: {EXAMPLE_OF_SIZE}")
        sizes = {
            name: factor * number(value, f"{place}.{name}", "a length above 0", low=5e-324)
            for name, value in given.items()
            if name != "unit"
        }
        square = sizes.get("size", 0.0)
        return cls(sizes.get("x", square), sizes.get("y", square), sizes.get("z"))

    def __str__(self) -> str:
        known = [size for size in (self.x, self.y, self.z) if size is not None]
        return " × ".join(f"{1e3 * size:.6g}" for size in known) + " µm"


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
    scale: str | None = None
    dataset: str | None = None
    channel: str | None = None
    reader: str | None = None

    def __post_init__(self) -> None:
        _checked({name: value for name, value in self.given.items() if name != "pixel"}, "image")

    @classmethod
    def from_options(cls, options: object, place: str) -> "PictureReading":
        """Return the reading that a study file asks for at `place`.

        Raises:
            InvalidInput: An option is unknown or cannot be used.
        """
        given = keys_of(options, [f.name for f in dataclasses.fields(cls)], place, EXAMPLE)
        return cls(**_checked({name: value for name, value in given.items() if value is not None}, place))

    @property
    def given(self) -> dict[str, Any]:
        """The options that differ from their defaults."""
        return {f.name: v for f in dataclasses.fields(self) if (v := getattr(self, f.name)) != f.default}


def _checked(values: Mapping[str, Any], place: str) -> dict[str, Any]:
    """Return the options after a check of each."""
    if values.get("average") is True and "page" in values:
        raise unfit(place, "page and average", "one of the two", f"Remove one of them from {place}.")
    return {name: CHECKS[name](value, f"{place}.{name}") for name, value in values.items()}


def _page(value: object, place: str) -> int:
    if type(value) is int and value >= 0:
        return value
    raise unfit(place, value, "the number of a frame, from 0")


def _average(value: object, place: str) -> bool:
    if isinstance(value, bool):
        return value
    raise unfit(place, value, "true or false")


def _index(value: object, place: str) -> float:
    low, high = INDICES
    return number(value, place, f"a refractive index from {low:g} to {high:g}, e.g. 1.333 for water", low, high)


def _text(value: object, place: str) -> str:
    if isinstance(value, str) and value:
        return value
    raise unfit(place, value, "a text")


def _reader(value: object, place: str) -> str:
    name = _text(value, place)
    if not callable(imported(name, place)):
        raise unfit(place, name, "a function (path, how, name) -> PictureFile")
    return name


CHECKS: dict[str, Callable[[object, str], Any]] = {
    "page": _page,
    "average": _average,
    "pixel": PixelSize.from_options,
    "index": _index,
    "scale": lambda value, place: word(value, SCALES, place),
    "dataset": _text,
    "channel": lambda value, place: word(value, CHANNELS, place),
    "reader": _reader,
}
"""Option → check (value, place) that returns the value."""
