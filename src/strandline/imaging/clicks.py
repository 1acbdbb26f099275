"""What a person marked in a picture: scale bar, origin, first path, regions; and the file that keeps it."""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.foundations import content_of, keys_of, named, number, suggestion, unfit
from strandline.imaging.paths import as_points, require_inside, require_path, require_polygon

Point = tuple[float, float]
"""Pixel coordinates (x, y)."""
WIDEST = 1 << 31
"""Largest width and height of a picture, in pixels."""
VERSION = 1
"""Version of the file's schema."""
NEEDED = ("version", "image", "sha256", "size", "path")
KEYS = (*NEEDED, "closed", "scale", "origin", "exclude", "fixed")
OF_SCALE = ("from", "to", "length_mm")
SUFFIX = ".path.json"
"""End of the names under which the page of clicks saves."""
_AGAIN = "Correct it, or click again."


@dataclass(frozen=True)
class ScaleBar:
    """A line of known length in a picture.

    Args:
        start: One end, in pixels.
        end: The other end, in pixels.
        length_mm: Length of the line, in mm.

    Raises:
        InvalidInput: A value that is not finite, ends that coincide, or a length that is not above 0.
    """

    start: Point
    end: Point
    length_mm: float

    def __post_init__(self) -> None:
        as_points([self.start, self.end], "scale bar")
        _length(self.length_mm)
        if self.pixels == 0:
            expected, remedy = "two ends that differ", "Draw the bar again."
            raise unfit("scale bar of no length in the picture", list(self.start), expected, remedy)

    @property
    def pixels(self) -> float:
        """Length of the line in the picture, in pixels."""
        return math.dist(self.start, self.end)


@dataclass(frozen=True, eq=False)
class Clicks:
    """What a person marked in one picture.

    Coordinates are pixels (x, y) of the whole picture: y points down, the centre of the top left pixel is (0, 0).

    Args:
        image: File name of the picture.
        sha256: SHA-256 checksum of the picture's file, in hexadecimal.
        size: Width and height of the picture, in pixels.
        path: Rough path along the edge, in order; empty if the picture only serves to register another one to it, by
            `fixed`.
        closed: Whether the last point of the path is joined to the first.
        scale: Line of known length.
        origin: Pixel of the model's point (0, 0); it may lie outside the picture.
        exclude: Regions in which no edge is looked for, each the corners of a polygon.
        fixed: Regions that do not move between the undeformed and the deformed picture, each the corners of a polygon.

    Raises:
        InvalidInput: A checksum or size that cannot be one, a path or a region with fewer than 3 points, a path that
            crosses itself, or a point outside the picture.
    """

    image: str
    sha256: str
    size: tuple[int, int]
    path: Float[np.ndarray, "point 2"]
    closed: bool = False
    scale: ScaleBar | None = None
    origin: Point | None = None
    exclude: tuple[Float[np.ndarray, "_ 2"], ...] = ()
    fixed: tuple[Float[np.ndarray, "_ 2"], ...] = ()

    def __post_init__(self) -> None:
        if not re.fullmatch("[0-9a-f]{64}", self.sha256):
            raise unfit("checksum of the picture", self.sha256, "64 digits 0-9, a-f", _AGAIN)
        if min(self.size) < 1 or max(self.size) > WIDEST:
            expected = f"[width, height] from 1 to {WIDEST} px"
            raise unfit("size of the picture", list(self.size), expected, _AGAIN)
        if len(self.path) or not self.fixed:
            require_path(self.path, "the path", closed=self.closed)
            require_inside(self.path, self.size, "the path")
        if self.scale is not None:
            require_inside(np.array([self.scale.start, self.scale.end]), self.size, "scale bar")
        if self.origin is not None:
            as_points([self.origin], "origin")
        for kind, regions in (("exclude", self.exclude), ("fixed", self.fixed)):
            for k, corners in enumerate(regions, 1):
                require_polygon(corners, f"{kind}: region {k}")
                require_inside(corners, self.size, f"{kind}: region {k}")

    @property
    def pixel_mm(self) -> float | None:
        """Size of a square pixel from the scale bar, in mm."""
        return None if self.scale is None else self.scale.length_mm / self.scale.pixels

    def require_picture(self, sha256: str, size: tuple[int, int]) -> None:
        """Refuse a picture with another checksum or size (width, height) than the one that was clicked on."""
        remedy = "Give that picture, or mark this one again: `strandline image STUDY --edit`."
        made = f"the clicks on {self.image} were made on"
        if sha256.lower() != self.sha256:
            found, expected = f"SHA-256 {sha256[:12]}…", f"{self.sha256[:12]}…"
            raise unfit(f"{made} another picture than this one", found, expected, remedy)
        if tuple(size) != self.size:
            found, expected = (f"{width} × {height} px" for width, height in (size, self.size))
            raise unfit(f"{made} a picture of another size", found, expected, remedy)


def read_clicks(path: Path) -> Clicks:
    """Return the clicks in a file that the page of clicks saved.

    Args:
        path: A file ``NAME.path.json``.

    Raises:
        InvalidInput: A file that is missing, not JSON or of a newer version; a key that is missing or unknown; or
            anything that `Clicks` refuses. The message begins with the name of the file.
    """
    with named(path.name):
        found = _contents(path)
        for key, kind in (("image", str), ("sha256", str), ("closed", bool)):
            if not isinstance(found.get(key, False), kind):
                raise unfit(key, found[key], "a text" if kind is str else "true or false", _AGAIN)
        return Clicks(
            image=found["image"],
            sha256=found["sha256"],
            size=_size(found["size"]),
            path=as_points(found["path"], "the path"),
            closed=found.get("closed", False),
            scale=_scale(found.get("scale")),
            origin=None if found.get("origin") is None else _point(found["origin"], "origin"),
            exclude=_regions(found, "exclude"),
            fixed=_regions(found, "fixed"),
        )


def as_json(clicks: Clicks) -> dict[str, Any]:
    """Return the contents of the file as plain data."""
    bar = clicks.scale
    return {
        "version": VERSION,
        "image": clicks.image,
        "sha256": clicks.sha256,
        "size": list(clicks.size),
        "scale": bar and {"from": list(bar.start), "to": list(bar.end), "length_mm": bar.length_mm},
        "origin": None if clicks.origin is None else list(clicks.origin),
        "path": clicks.path.tolist(),
        "closed": clicks.closed,
        "exclude": [corners.tolist() for corners in clicks.exclude],
        "fixed": [corners.tolist() for corners in clicks.fixed],
    }


def _contents(path: Path) -> Mapping[str, Any]:
    if not path.exists():
        there = sorted(one.name for one in path.parent.glob(f"*{SUFFIX}"))
        only = f"Did you mean {there[0]}?" if len(there) == 1 else "Move it there, or correct its name."
        value = f"no such file; the folder has {', '.join(there) or 'no file of clicks'}"
        expected = f"a file of clicks, PICTURE{SUFFIX}, at the path that the study gives"
        raise unfit("cannot be read", value, expected, suggestion(path.name, there, only))
    content = content_of(path, "a file of clicks, NAME.path.json")
    try:
        found = json.loads(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise unfit("is not JSON", str(error), "a file that the page of clicks saved", _AGAIN) from None
    found = _with_keys(found, KEYS, NEEDED, "clicks")
    if found["version"] != VERSION:
        raise unfit("version of the file", found["version"], f"{VERSION}", "Update strandline, or click again.")
    return found


def _with_keys(found: object, known: tuple[str, ...], needed: tuple[str, ...], place: str) -> Mapping[str, Any]:
    given = keys_of(found, known, place, ", ".join(needed))
    for key in needed:
        if key not in given:
            raise unfit(f"{place}: {key} is missing", None, f"the keys {', '.join(needed)}", _AGAIN)
    return given


def _size(found: object) -> tuple[int, int]:
    if isinstance(found, list) and len(found) == 2 and all(type(value) is int for value in found):
        return found[0], found[1]
    raise unfit("size of the picture", found, "[width, height], in pixels", _AGAIN)


def _scale(found: object) -> ScaleBar | None:
    if found is None:
        return None
    bar = _with_keys(found, OF_SCALE, OF_SCALE, "scale bar")
    start, end = (_point(bar[key], f"scale bar: {key}") for key in ("from", "to"))
    return ScaleBar(start, end, _length(bar["length_mm"]))


def _length(value: object) -> float:
    return number(value, "length of the scale bar", "a number above 0, in mm", low=5e-324)


def _point(found: object, what: str) -> Point:
    ((x, y),) = as_points([found], what).tolist()
    return x, y


def _regions(found: Mapping[str, Any], key: str) -> tuple[Any, ...]:
    regions = found.get(key) or []
    if not isinstance(regions, list):
        raise unfit(key, regions, "a list of regions, each a list of corners [x, y]", _AGAIN)
    return tuple(as_points(corners, f"{key}: region {number}") for number, corners in enumerate(regions, 1))
