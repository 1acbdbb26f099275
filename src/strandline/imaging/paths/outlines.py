"""Outlines of labelme, GeoJSON (QuPath, rasterio, shapely) and Cellpose, in pixels of a picture.

labelme and GeoJSON count from the top left corner of the picture: the centre of the first pixel is (0.5, 0.5). An
outline of Cellpose, like those of OpenCV, runs through the centres of the outermost pixels of a cell, the first pixel's
at (0, 0); the edge itself is half a pixel outside.
"""

import numpy as np

from strandline.errors import InvalidInput
from strandline.imaging.paths.first_path import FirstPath
from strandline.imaging.paths.repeats import without_repeats
from strandline.readers.json_outlines import Outline, outlines

__all__ = ["path_of_cellpose", "path_of_json"]


def path_of_json(content: bytes) -> FirstPath:
    """Return the only outline of a labelme or GeoJSON file.

    Raises:
        InvalidInput: A damaged file, no outline or several, or points that make no path.
    """
    try:
        found = outlines(content)
    except (ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
        raise _refused("cannot be read", f"{type(error).__name__}: {error}") from None
    path = _only(found)
    return FirstPath(path.points - 0.5, path.closed)


def path_of_cellpose(content: bytes) -> FirstPath:
    """Return the only outline of ``NAME_cp_outlines.txt``, which has a cell in each line: x and y in turn.

    Raises:
        InvalidInput: A damaged file, several cells, or points that make no path.
    """
    lines = [line for line in content.decode("utf-8", "replace").splitlines() if line.strip()]
    try:
        return _only([(np.array(line.split(","), dtype=float).reshape(-1, 2), True) for line in lines])
    except ValueError as error:
        raise _refused("cannot be read", str(error)) from None


def _only(found: list[Outline]) -> FirstPath:
    if len(found) != 1:
        raise _refused(f"holds {len(found) or 'no'} outlines", f"{len(found)} outlines")
    points, closed = found[0]
    return without_repeats(points, closed=closed)


def _refused(what: str, value: str) -> InvalidInput:
    expected = "one line or polygon, the path along the edge"
    return InvalidInput(what, value=value, expected=expected, remedy="Keep the one that is meant in a file of its own.")
