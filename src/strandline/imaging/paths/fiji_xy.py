"""Fiji and ImageJ: a selection saved with File > Save As > XY Coordinates.

The file does not say whether the selection was a line, whose integers are centres of pixels, or an area, whose integers
are corners. It is read as a line; the half pixel does not matter to a first path. If the picture has a scale, the
coordinates are lengths instead of pixels; a path of a few pixels is therefore refused.
"""

import re

import numpy as np
from jaxtyping import Float

from strandline.errors import InvalidInput
from strandline.imaging.paths.first_path import FirstPath
from strandline.imaging.paths.repeats import without_repeats
from strandline.readers.order import require_in_order
from strandline.text import decimal

__all__ = ["path_of_xy"]

SMALLEST = 10.0
"""Extent of a path, in pixels, below which its coordinates cannot be pixels."""
REMEDY = (
    "In Fiji, save the selection itself as .roi, or remove the scale (Analyze > Set Scale) before saving coordinates."
)


def path_of_xy(content: bytes) -> FirstPath:
    """Return the path in a text file with x and y in each line, with or without a line of column names.

    Args:
        content: The whole file.

    Raises:
        InvalidInput: A line without two numbers, coordinates that cannot be pixels, or points that make no path.
    """
    points = _points(content)
    require_in_order(points, "the path", "Of OpenDrop take fit.csv, which runs along the profile.")
    found = without_repeats(points)
    extent = float(np.ptp(found.points, axis=0).max())
    if extent < SMALLEST:
        raise _refused(
            "extent of the path", f"{extent:.3g}", f"at least {SMALLEST:g} px, as coordinates in pixels have"
        )
    return found


def _points(content: bytes) -> Float[np.ndarray, "point 2"]:
    try:
        lines = content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise _refused("is no text", repr(content[:16]), "lines with x and y") from None
    rows = [(number, re.findall(r"[^,;\s]+", line)) for number, line in enumerate(lines, 1) if line.strip(",; \t")]
    first = rows[0][1] if rows else []
    if any(decimal(field) is None for field in first):
        rows = rows[1:]
        if [field.strip('"').lower() for field in first] != ["x", "y"]:
            raise _refused("names its columns", ", ".join(first), "X, Y: the outline, not the pixels in it")
        if rows and all(len(fields) == 3 for _, fields in rows):  # a column without a name that numbers the points
            rows = [(number, fields[1:]) for number, fields in rows]
    return np.array([_point(number, fields) for number, fields in rows]).reshape(-1, 2)


def _point(number: int, fields: list[str]) -> tuple[float, float]:
    values = [decimal(field) for field in fields]
    if len(values) == 2 and values[0] is not None and values[1] is not None:
        return values[0], values[1]
    raise _refused(f"has no point in line {number}", " ".join(fields), "two numbers, x and y in pixels")


def _refused(what: str, value: object, expected: str) -> InvalidInput:
    return InvalidInput(what, value=value, expected=expected, remedy=REMEDY)
