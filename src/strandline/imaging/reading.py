"""How to read a picture: the options of `observation.image` that concern the file."""

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from strandline.imaging.checked import keys_of, number, unfit, word
from strandline.imaging.pixel_size import PixelSize
from strandline.registry import imported

__all__ = ["CHANNELS", "SCALES", "PictureReading"]

SCALES = ("intensity", "amplitude", "log10", "dB", "sRGB")
"""What the numbers in the file are: the intensity, its root, its logarithm, 10 log10 of it, or coded for a screen."""
CHANNELS = ("grey", "red", "green", "blue")
INDICES = (1.0, 4.0)
"""Smallest and largest refractive index that is accepted."""
EXAMPLE = "{pixel: {x: 6.0, y: 4.0, unit: um}, scale: intensity}"


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
