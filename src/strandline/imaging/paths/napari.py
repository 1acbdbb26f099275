"""napari: a Shapes layer saved as ``.csv``.

Its last two axes are row and column, in pixels; the centre of the top left pixel is (0, 0).
"""

import csv
import io
import re

import numpy as np

from strandline.errors import InvalidInput
from strandline.imaging.paths.first_path import FirstPath
from strandline.imaging.paths.repeats import without_repeats
from strandline.text import decimal

__all__ = ["path_of_shapes"]

CLOSED = {"path": False, "line": False, "polygon": True, "rectangle": True}
"""Kinds of shapes that are read → whether they are closed."""
KEYS = ("index", "shape-type", "vertex-index", "axis-0", "axis-1")


def path_of_shapes(content: bytes) -> FirstPath:
    """Return the only shape in a Shapes layer: open for a path, closed for a polygon.

    Args:
        content: The whole file.

    Raises:
        InvalidInput: Several shapes, an ellipse, a column that is missing, or points that make no path.
    """
    try:
        rows = list(csv.DictReader(io.StringIO(content.decode("utf-8-sig")), strict=True))
    except (ValueError, csv.Error) as error:
        raise _refused("is no table", str(error), f"columns {', '.join(KEYS)}") from None
    missing = [key for key in KEYS if not rows or rows[0].get(key) is None]
    if missing:
        raise _refused("holds no shape", f"no {', '.join(missing)}", f"columns {', '.join(KEYS)}")
    shapes = sorted({row["index"] for row in rows})
    if len(shapes) > 1:
        raise _refused("holds several shapes", f"{len(shapes)}", "one, the path along the edge")
    kind = rows[0]["shape-type"]
    if kind not in CLOSED:
        raise _refused("holds a shape that is no path", kind, ", ".join(CLOSED))
    axes = sorted((key for key in rows[0] if re.fullmatch("axis-[0-9]{1,2}", key or "")), key=lambda key: int(key[5:]))
    points = [[_number(row[axis], line) for axis in axes[:-3:-1]] for line, row in enumerate(rows, 2)]
    return without_repeats(np.array(points), closed=CLOSED[kind])


def _number(field: str | None, line: int) -> float:
    value = None if field is None else decimal(field.strip())
    if value is None:
        raise _refused(f"has no point in line {line}", field, "numbers for row and column, in pixels")
    return value


def _refused(what: str, value: object, expected: str) -> InvalidInput:
    remedy = "In napari, draw one path along the edge in a layer of its own and save that layer as .csv."
    return InvalidInput(what, value=value, expected=expected, remedy=remedy)
