"""The file of clicks, ``NAME.path.json``."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from strandline.errors import InvalidInput
from strandline.imaging.clicks import Clicks, Point, ScaleBar
from strandline.imaging.paths.first_path import as_points
from strandline.registry import suggestion

__all__ = ["VERSION", "as_json", "read_clicks", "write_clicks"]

VERSION = 1
"""Version of the file's schema."""
NEEDED = ("version", "image", "sha256", "size", "path")
OPTIONAL = ("closed", "scale", "origin", "exclude", "fixed")
OF_SCALE = ("from", "to", "length_mm")
SUFFIX = ".path.json"
"""End of the names under which the page of clicks saves."""
LARGEST = 1 << 23
"""Bytes of a file that is read."""


def read_clicks(path: Path) -> Clicks:
    """Return the clicks in a file that the page or `write_clicks` wrote.

    Args:
        path: A file ``NAME.path.json``.

    Raises:
        InvalidInput: A file that is missing, not JSON or of a newer version; a key that is missing or unknown; or
            anything that `Clicks` refuses. The message begins with the name of the file.
    """
    try:
        return _clicks(_contents(path))
    except InvalidInput as error:
        raise InvalidInput(
            f"{path.name}: {error.what}", value=error.value, expected=error.expected, remedy=error.remedy
        ) from None


def write_clicks(clicks: Clicks, path: Path) -> None:
    """Write a file that `read_clicks` reads, whole or not at all; coordinates keep all their digits."""
    rows = ",\n".join(f"  {json.dumps(key)}: {json.dumps(value)}" for key, value in as_json(clicks).items())
    unfinished = path.with_name(f".{path.name}.partial")
    unfinished.write_text(f"{{\n{rows}\n}}\n", encoding="utf-8")
    unfinished.replace(path)


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
    """Return the file as plain data with the right keys."""
    try:
        with path.open("rb") as file:
            text = file.read(LARGEST + 1)
        found = json.loads(text.decode("utf-8-sig")) if len(text) <= LARGEST else None
    except FileNotFoundError:
        raise _missing(path) from None
    except OSError as error:
        raise _refused("cannot be read", error.strerror or str(error), "a file of clicks, NAME.path.json") from None
    except json.JSONDecodeError as error:
        place = f"an error in line {error.lineno}, column {error.colno}"
        raise _refused("is not JSON", place, "a file that the page of clicks saved") from None
    except (ValueError, RecursionError) as error:
        raise _refused("is not JSON", str(error), "a file that the page of clicks saved") from None
    if len(text) > LARGEST:
        raise _refused("size of the file", f"more than {LARGEST} bytes", "a file of clicks")
    if not isinstance(found, Mapping):
        raise _refused("is no file of clicks", f"a {type(found).__name__}", f"an object with {', '.join(NEEDED)}")
    _require_keys(found, NEEDED, OPTIONAL)
    if found["version"] != VERSION:
        remedy = "Update strandline, or click again."
        raise _refused("version of the file", found["version"], f"{VERSION}", remedy)
    return found


def _missing(path: Path) -> InvalidInput:
    """Return the error for a file that is not there, with the files of clicks that are."""
    there = sorted(one.name for one in path.parent.glob(f"*{SUFFIX}"))
    only = f"Did you mean {there[0]}?" if len(there) == 1 else "Move it there, or correct its name."
    return _refused(
        "cannot be read",
        f"no such file; the folder has {', '.join(there) or 'no file of clicks'}",
        f"a file of clicks, PICTURE{SUFFIX}, at the path that the study gives",
        suggestion(path.name, there, only),
    )


def _clicks(found: Mapping[str, Any]) -> Clicks:
    for key in ("image", "sha256"):
        if not isinstance(found[key], str):
            raise _refused(key, found[key], "a text")
    if not isinstance(found.get("closed", False), bool):
        raise _refused("closed", found["closed"], "true or false")
    origin = found.get("origin")
    return Clicks(
        image=found["image"],
        sha256=found["sha256"],
        size=_size(found["size"]),
        path=as_points(found["path"], "the path"),
        closed=found.get("closed", False),
        scale=_scale(found.get("scale")),
        origin=None if origin is None else _point(origin, "origin"),
        exclude=_regions(found, "exclude"),
        fixed=_regions(found, "fixed"),
    )


def _size(found: object) -> tuple[int, int]:
    if isinstance(found, list) and len(found) == 2 and all(type(value) is int for value in found):
        return found[0], found[1]
    raise _refused("size of the picture", found, "[width, height], in pixels")


def _scale(found: object) -> ScaleBar | None:
    if found is None:
        return None
    if not isinstance(found, Mapping):
        raise _refused("scale bar", found, f"an object with {', '.join(OF_SCALE)}, or null")
    _require_keys(found, OF_SCALE, (), "scale bar: ")
    length = found["length_mm"]
    if isinstance(length, bool) or not isinstance(length, int | float):
        raise _refused("length of the scale bar", length, "a number above 0, in mm")
    start, end = (_point(found[key], f"scale bar: {key}") for key in ("from", "to"))
    try:
        return ScaleBar(start, end, float(length))
    except OverflowError:  # an integer of hundreds of digits
        return ScaleBar(start, end, math.inf)


def _point(found: object, what: str) -> Point:
    ((x, y),) = as_points([found], what).tolist()
    return x, y


def _regions(found: Mapping[str, Any], key: str) -> tuple[Any, ...]:
    regions = found.get(key) or []
    if not isinstance(regions, list):
        raise _refused(key, regions, "a list of regions, each a list of corners [x, y]")
    return tuple(as_points(corners, f"{key}: region {number}") for number, corners in enumerate(regions, 1))


def _require_keys(
    found: Mapping[str, Any], needed: tuple[str, ...], optional: tuple[str, ...], place: str = ""
) -> None:
    for key in needed:
        if key not in found:
            raise _refused(f"{place}{key} is missing", None, f"the keys {', '.join(needed)}")
    for key in found:
        if key not in (*needed, *optional):
            known = (*needed, *optional)
            remedy = suggestion(str(key), known, "Remove it.")
            raise _refused(f"{place}unknown key", key, f"one of {', '.join(known)}", remedy)


def _refused(
    what: str, value: object, expected: str, remedy: str = "Correct the file, or click again."
) -> InvalidInput:
    return InvalidInput(what, value=value, expected=expected, remedy=remedy)
