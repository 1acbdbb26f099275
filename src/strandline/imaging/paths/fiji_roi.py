"""Fiji and ImageJ: a selection saved as ``.roi``.

The format: 64 bytes of header, then 16-bit coordinates relative to the bounding box, then, if bit 7 of the options is
set, the same points as 32-bit floats in pixels of the picture; all big-endian. Integer coordinates of lines are centres
of pixels; those of areas are top left corners of pixels (ImageJ's documentation of ``ij.gui.Roi``).
"""

import numpy as np
from jaxtyping import Float

from strandline.errors import InvalidInput
from strandline.imaging.paths.first_path import FirstPath
from strandline.imaging.paths.repeats import without_repeats

__all__ = ["path_of_roi"]

AREAS = {0: "polygon", 7: "freehand area", 8: "traced area"}
LINES = {4: "freehand line", 5: "segmented line"}
OTHERS = {1: "rectangle", 2: "ellipse", 3: "straight line", 6: "empty selection", 9: "angle", 10: "points"}
HEADER = 64
TYPE, LEFT_TOP, NUMBER, LARGE_NUMBER, COMPOSITE, OPTIONS = 6, 8, 16, 18, 36, 50
"""Offsets of the fields that are read, in bytes."""
FAR_BELOW = -5000
"""Integers below it are unsigned ones above 32767, as ImageJ takes them."""
SUB_PIXEL = 128
"""Bit of the options: coordinates as floats follow the integers."""


def path_of_roi(content: bytes) -> FirstPath:
    """Return the path in a ``.roi`` file: open for a line, closed for an area.

    Args:
        content: The whole file.

    Raises:
        InvalidInput: A file that is cut off, or a selection of another kind.
    """
    if len(content) < HEADER or not content.startswith(b"Iout"):
        raise _refused("is no whole .roi file", f"{len(content)} bytes", f"Iout, and at least {HEADER} bytes")
    kind = content[TYPE]
    if (kind not in AREAS and kind not in LINES) or _integer(content, COMPOSITE, 4) > 0:
        found = "composite selection" if _integer(content, COMPOSITE, 4) > 0 else OTHERS.get(kind, f"type {kind}")
        raise _refused("holds a selection that is no path", found, ", ".join([*LINES.values(), *AREAS.values()]))
    points = _points(content)
    if kind in AREAS:
        return without_repeats(points - 0.5, closed=True)
    return without_repeats(points)


def _points(content: bytes) -> Float[np.ndarray, "point 2"]:
    """Return the points in ImageJ's own coordinates."""
    number = _integer(content, NUMBER, 2) or _integer(content, LARGE_NUMBER, 4)
    floats = bool(_integer(content, OPTIONS, 2) & SUB_PIXEL)
    needed = HEADER + number * (12 if floats else 4)
    if len(content) < needed:
        raise _refused("is cut off", f"{len(content)} bytes", f"{needed}, for {number} points")
    if floats:
        return np.frombuffer(content, ">f4", 2 * number, HEADER + 4 * number).reshape(2, -1).T.astype(float)
    relative = np.frombuffer(content, ">i2", 2 * number, HEADER).reshape(2, -1).T.astype(float)
    top_left = np.frombuffer(content, ">i2", 2, LEFT_TOP).astype(float)
    relative, corner = (np.where(x < FAR_BELOW, x + 2**16, x) for x in (relative, top_left[::-1]))
    return np.asarray(relative + corner)


def _integer(content: bytes, offset: int, size: int) -> int:
    return int.from_bytes(content[offset : offset + size], "big")


def _refused(what: str, value: object, expected: str) -> InvalidInput:
    remedy = "In Fiji, draw a segmented line along the edge and save it with File > Save As > Selection."
    return InvalidInput(what, value=value, expected=expected, remedy=remedy)
