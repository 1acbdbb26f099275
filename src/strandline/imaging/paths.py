"""The first path along an edge: what it must fulfil, and files that hold one.

They are selections of Fiji, shapes of napari, outlines of labelme, QuPath and Cellpose. Where these have the centre of
the top left pixel, in pixels:

- Fiji and ImageJ, lines (``.roi`` and XY coordinates), napari, Cellpose and OpenCV: (0, 0);
- Fiji's areas, whose integers are corners of pixels, labelme and GeoJSON (QuPath, rasterio): (0.5, 0.5).

XY coordinates do not say whether they were a line or an area, and are read as a line; half a pixel does not matter to a
first path. If the picture has a scale they are lengths; a path of a few pixels is therefore refused. OpenDrop needs no
path, but the profile of the drop that it saves, ``fit.csv``, serves as one.
"""

import csv
import io
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from strandline.foundations import InvalidInterface, content_of, decimal, is_finite, named, unfit
from strandline.interface import Interface
from strandline.readers import outlines, require_in_order

FEWEST, MOST = 3, 20_000
"""Smallest and largest number of points of a path, and of corners of a region."""


class FirstPath(NamedTuple):
    """A polyline near the edge, from which the search for the edge starts.

    `points`: pixel coordinates (x, y), in their order along the edge; y points down and the centre of the top left
    pixel is (0, 0). `closed`: whether the last point is joined to the first.
    """

    points: Float[np.ndarray, "point 2"]
    closed: bool = False


def typed_path(
    points: object, *, closed: bool = False, size: tuple[int, int] | None = None, what: str = "the path"
) -> FirstPath:
    """Return the path through points that somebody typed.

    Args:
        points: Rows (x, y) in pixels: a list of pairs, or an array.
        closed: Whether the last point is joined to the first.
        size: Width and height of the picture in pixels, if the points must lie in it.
        what: Name of the path in messages, e.g. ``observation.path``.

    Raises:
        InvalidInput: Something that is not a list of pairs of finite numbers, fewer than 3 points, a point outside the
            picture, a repeated point, or a path that crosses itself.
    """
    found = as_points(points, what)
    if size is not None:
        require_inside(found, size, what)
    require_path(found, what, closed=closed)
    return FirstPath(found, closed)


def as_points(found: object, what: str) -> Float[np.ndarray, "point 2"]:
    """Return a list of pairs of numbers as an array; refusals count points from 1."""
    rows = found.tolist() if isinstance(found, np.ndarray) else found
    if not isinstance(rows, Sequence) or isinstance(rows, str):
        raise unfit(what, found, "a list of points [x, y] in pixels")
    for number, row in enumerate(rows, 1):
        pair = isinstance(row, Sequence) and not isinstance(row, str) and len(row) == 2
        if not (pair and all(isinstance(v, int | float) and not isinstance(v, bool) for v in row)):
            raise unfit(f"{what}: point {number}", row, "two numbers [x, y], in pixels")
        if not all(is_finite(value) for value in row):
            raise unfit(f"{what}: point {number} is not finite", row, "two finite numbers [x, y], in pixels")
    return np.array(rows, dtype=float).reshape(-1, 2)


def require_path(points: Float[np.ndarray, "point 2"], what: str, *, closed: bool) -> None:
    """Refuse points that make no path: too few, repeated or not finite, or a path that crosses itself."""
    require_polygon(points, what)
    following = np.roll(points, -1, axis=0) if closed else points[1:]
    repeated = np.flatnonzero((points[: len(following)] == following).all(axis=1))
    if repeated.size:
        first, second = int(repeated[0]) + 1, (int(repeated[0]) + 1) % len(points) + 1
        expected = "points that differ from the ones before them"
        remedy = "Remove one of the two; a closed path does not repeat its first point."
        raise unfit(f"{what}: points {first} and {second} coincide", points[first - 1].tolist(), expected, remedy)
    require_simple(points, what, closed=closed)


def require_simple(points: Float[np.ndarray, "point 2"], what: str, *, closed: bool) -> None:
    """Refuse a path that crosses or touches itself."""
    try:
        Interface.polyline(points, closed=closed).require_simple()
    except InvalidInterface as error:
        found = str(error.value).removesuffix("mm") + "px"
        expected = "a path without crossings, its points in order along the edge"
        raise unfit(f"{what} crosses or touches itself", found, expected, "Move or remove points there.") from None


def require_polygon(points: Float[np.ndarray, "point 2"], what: str) -> None:
    """Refuse points that are too few, too many or not finite."""
    if len(points) < FEWEST:
        raise unfit(f"{what} has too few points", len(points), f"at least {FEWEST}", "Click more of them.")
    if len(points) > MOST:
        remedy = "Leave some out: 5 to 12 along the edge are enough."
        raise unfit(f"{what} has too many points", len(points), f"at most {MOST}", remedy)
    require_finite(points, what)


def require_finite(points: Float[np.ndarray, "point 2"], what: str) -> None:
    """Refuse points of which a coordinate is no number; the message counts points from 1."""
    wrong = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if wrong.size:
        number = int(wrong[0]) + 1
        raise unfit(f"{what}: point {number} is not finite", points[number - 1].tolist(), "finite numbers")


def require_inside(points: Float[np.ndarray, "point 2"], size: tuple[int, int], what: str) -> None:
    """Refuse points outside a picture, whose pixels reach from -0.5 to width - 0.5 and to height - 0.5."""
    width, height = size
    outside = np.flatnonzero(((points < -0.5) | (points > np.array([width, height]) - 0.5)).any(axis=1))
    if outside.size:
        number = int(outside[0]) + 1
        expected = f"x from -0.5 to {width - 0.5:g} and y from -0.5 to {height - 0.5:g} px"
        remedy = "Move the point, or give the picture that the points belong to."
        raise unfit(f"{what}: point {number} is outside the picture", points[number - 1].tolist(), expected, remedy)


READ = "a path saved by Fiji (.roi, XY coordinates), napari (.csv), labelme, QuPath or Cellpose"
SMALLEST = 10.0
"""Extent of a path, in pixels, below which its coordinates cannot be pixels."""

HEADER = 64
"""Bytes at the start of a ``.roi`` file."""
TYPE, LEFT_TOP, NUMBER, LARGE_NUMBER, COMPOSITE, OPTIONS = 6, 8, 16, 18, 36, 50
"""Offsets of the fields that are read, in bytes."""
AREAS = {0: "polygon", 7: "freehand area", 8: "traced area"}
LINES = {4: "freehand line", 5: "segmented line"}
OTHERS = {1: "rectangle", 2: "ellipse", 3: "straight line", 6: "empty selection", 9: "angle", 10: "points"}
FAR_BELOW = -5000
"""Integers below it are unsigned ones above 32767, as ImageJ takes them."""
SUB_PIXEL = 128
"""Bit of the options: coordinates as floats follow the integers."""

SHAPES = {"path": False, "line": False, "polygon": True, "rectangle": True}
"""Kinds of napari's shapes that are read → whether they are closed."""
COLUMNS = ("index", "shape-type", "vertex-index", "axis-0", "axis-1")

_NO_ROI = "In Fiji, draw a segmented line along the edge and save it with File > Save As > Selection."
_NO_XY = (
    "In Fiji, save the selection itself as .roi, or remove the scale (Analyze > Set Scale) before saving coordinates."
)
_NO_SHAPE = "In napari, draw one path along the edge in a layer of its own and save that layer as .csv."


def read_path(path: Path, *, size: tuple[int, int] | None = None) -> FirstPath:
    """Return the path in a file that another program exported; its contents determine the format.

    Files of clicks are read by `read_clicks`, which knows the picture that they belong to.

    Args:
        path: The file.
        size: Width and height of the picture in pixels, if the path must lie in it.

    Raises:
        InvalidInput: A file that cannot be read or holds no usable path. The message begins with its name.
    """
    with named(path.name):
        content = content_of(path, READ)
        found = _reader(content)(content)
        require_path(found.points, "the path", closed=found.closed)
        if size is not None:
            require_inside(found.points, size, "the path")
    return found


def is_of_clicks(path: Path) -> bool:
    """Return whether a file is one of clicks by its name, and holds no outline that another program drew."""
    return path.suffix == ".json" and not (path.is_file() and _is_drawn(content_of(path, READ)))


def _reader(content: bytes) -> Callable[[bytes], FirstPath]:
    if content.startswith(b"Iout"):
        return _of_roi
    if content.startswith(b"PK"):
        remedy = "Unpack it, or save the one selection that is meant."
        raise unfit("is an archive of several selections", "a .zip file", READ, remedy)
    begin = content[:200].decode("utf-8-sig", "replace").lstrip().lower()
    if begin.startswith("{"):
        if _is_drawn(content):
            return _of_outline
        raise unfit("is JSON, but is not used as a file of clicks", "{ …", READ, "Name it NAME.path.json.")
    first = begin.partition("\n")[0]
    if "axis-" in first and "vertex-index" in first:
        return _of_shapes
    return _of_outline if first.count(",") > 4 else _of_xy  # a line of Cellpose holds a whole cell


def _is_drawn(content: bytes) -> bool:
    """Return whether JSON has what labelme or GeoJSON calls an outline."""
    return b'"shapes"' in content or b'"coordinates"' in content


def _of_roi(content: bytes) -> FirstPath:
    """Return the path in a ``.roi`` file: open for a line, closed for an area.

    The format: 64 bytes of header, then 16-bit coordinates relative to the bounding box, then, if bit 7 of the options
    is set, the same points as 32-bit floats in pixels of the picture; all big-endian (ImageJ's documentation of
    ``ij.gui.Roi``).
    """
    if len(content) < HEADER:
        raise unfit("is no whole .roi file", f"{len(content)} bytes", f"at least {HEADER} bytes", _NO_ROI)
    kind, composite = content[TYPE], _integer(content, COMPOSITE, 4) > 0
    if composite or (kind not in AREAS and kind not in LINES):
        found = "composite selection" if composite else OTHERS.get(kind, f"type {kind}")
        expected = ", ".join([*LINES.values(), *AREAS.values()])
        raise unfit("holds a selection that is no path", found, expected, _NO_ROI)
    points = _points_of_roi(content)
    return _without_repeats(points - 0.5, closed=True) if kind in AREAS else _without_repeats(points)


def _points_of_roi(content: bytes) -> Float[np.ndarray, "point 2"]:
    """Return the points in ImageJ's own coordinates."""
    number = _integer(content, NUMBER, 2) or _integer(content, LARGE_NUMBER, 4)
    floats = bool(_integer(content, OPTIONS, 2) & SUB_PIXEL)
    needed = HEADER + number * (12 if floats else 4)
    if len(content) < needed:
        raise unfit("is cut off", f"{len(content)} bytes", f"{needed}, for {number} points", _NO_ROI)
    if floats:
        return np.frombuffer(content, ">f4", 2 * number, HEADER + 4 * number).reshape(2, -1).T.astype(float)
    relative = np.frombuffer(content, ">i2", 2 * number, HEADER).reshape(2, -1).T.astype(float)
    top_left = np.frombuffer(content, ">i2", 2, LEFT_TOP).astype(float)
    relative, corner = (np.where(x < FAR_BELOW, x + 2**16, x) for x in (relative, top_left[::-1]))
    return np.asarray(relative + corner)


def _integer(content: bytes, offset: int, size: int) -> int:
    return int.from_bytes(content[offset : offset + size], "big")


def _of_xy(content: bytes) -> FirstPath:
    """Return the path in a text file with x and y in each line, with or without a line of column names."""
    points = _points_of_text(content)
    require_in_order(points, "the path")
    found = _without_repeats(points)
    if len(points) and (extent := float(np.ptp(points, axis=0).max())) < SMALLEST:
        expected = f"at least {SMALLEST:g} px, as coordinates in pixels have"
        raise unfit("extent of the path", f"{extent:.3g}", expected, _NO_XY)
    return found


def _points_of_text(content: bytes) -> Float[np.ndarray, "point 2"]:
    try:
        lines = content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise unfit("is no text", repr(content[:16]), "lines with x and y", _NO_XY) from None
    rows = [(number, re.findall(r"[^,;\s]+", line)) for number, line in enumerate(lines, 1) if line.strip(",; \t")]
    first = rows[0][1] if rows else []
    if [field.strip('"').lower() for field in first] == ["x", "y"]:
        rows = rows[1:]
        if rows and all(len(fields) == 3 for _, fields in rows):  # a column without a name that numbers the points
            rows = [(number, fields[1:]) for number, fields in rows]
    elif first and all(decimal(field) is None for field in first):
        raise unfit("names its columns", ", ".join(first), "X, Y: the outline, not the pixels in it", _NO_XY)
    points = [_point(fields, point, line, _NO_XY) for point, (line, fields) in enumerate(rows, 1)]
    return np.array(points).reshape(-1, 2)


def _point(fields: list[str], number: int, line: int, remedy: str) -> tuple[float, float]:
    values = [value for field in fields if (value := decimal(field.strip())) is not None]
    if len(fields) == len(values) == 2:
        return values[0], values[1]
    expected = "two finite numbers, x and y in pixels"
    raise unfit(f"point {number}, in line {line}", " ".join(fields), expected, remedy)


def _of_shapes(content: bytes) -> FirstPath:
    """Return the only shape, path or polygon, in a Shapes layer of napari; the last two axes are row and column."""
    expected = f"columns {', '.join(COLUMNS)}"
    try:
        rows = list(csv.DictReader(io.StringIO(content.decode("utf-8-sig")), strict=True))
    except (ValueError, csv.Error) as error:
        raise unfit("is no table", str(error), expected, _NO_SHAPE) from None
    missing = [key for key in COLUMNS if not rows or rows[0].get(key) is None]
    if missing:
        raise unfit("holds no shape", f"no {', '.join(missing)}", expected, _NO_SHAPE)
    shapes = {row["index"] for row in rows}
    if len(shapes) > 1:
        raise unfit("holds several shapes", f"{len(shapes)}", "one, the path along the edge", _NO_SHAPE)
    kind = rows[0]["shape-type"]
    if kind not in SHAPES:
        raise unfit("holds a shape that is no path", kind, ", ".join(SHAPES), _NO_SHAPE)
    axes = sorted((key for key in rows[0] if re.fullmatch("axis-[0-9]{1,2}", key or "")), key=lambda key: int(key[5:]))
    last = axes[:-3:-1]
    points = [_point([row[axis] or "" for axis in last], k, k + 1, _NO_SHAPE) for k, row in enumerate(rows, 1)]
    return _without_repeats(np.array(points), closed=SHAPES[kind])


def _of_outline(content: bytes) -> FirstPath:
    """Return the only outline in a file in JSON, or in a list of Cellpose: x and y in turn, a cell in each line."""
    in_json = content.lstrip().startswith(b"{")
    cells = [] if in_json else [line.split(b",") for line in content.splitlines() if line.strip()]
    expected, remedy = "one line or polygon, the path along the edge", "Keep only that one in the file."
    try:
        found = outlines(content) if in_json else [(np.array(x, dtype=float).reshape(-1, 2), True) for x in cells]
    except (ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
        raise unfit("cannot be read", str(error), expected, remedy) from None
    if len(found) != 1:
        raise unfit("number of outlines", len(found), expected, remedy)
    path = _without_repeats(found[0][0], closed=found[0][1])
    return FirstPath(path.points - 0.5 * in_json, path.closed)


def _without_repeats(points: Float[np.ndarray, "point 2"], *, closed: bool = False) -> FirstPath:
    """Return the path through points without those that repeat the one before; it is closed if it ends at its first."""
    new = np.ones(len(points), dtype=bool)
    new[1:] = (points[1:] != points[:-1]).any(axis=1)
    kept = points[new]
    if len(kept) > 2 and (kept[0] == kept[-1]).all():
        kept, closed = kept[:-1], True
    return FirstPath(np.ascontiguousarray(kept), closed)
