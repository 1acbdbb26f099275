"""Outlines of labelme, GeoJSON (QuPath, rasterio) and Cellpose, in pixels of a picture.

labelme and GeoJSON count from the corner of the picture: the centre of the first pixel is (0.5, 0.5). An outline of
Cellpose, as of OpenCV, runs through the centres of a cell's outermost pixels, that of the first pixel (0, 0).
"""

import numpy as np

from strandline.errors import InvalidInput
from strandline.imaging.paths.first_path import FirstPath
from strandline.imaging.paths.repeats import without_repeats
from strandline.readers.outlines import outlines

__all__ = ["path_of_outline"]


def path_of_outline(content: bytes) -> FirstPath:
    """Return the only outline in a file in JSON, or in a list of Cellpose: x and y in turn, a cell in each line.

    Raises:
        InvalidInput: A damaged file, no outline or several, or points that make no path.
    """
    in_json = content.lstrip().startswith(b"{")
    cells = [] if in_json else [line.split(b",") for line in content.splitlines() if line.strip()]
    expected, remedy = "one line or polygon, the path along the edge", "Keep only that one in the file."
    try:
        found = outlines(content) if in_json else [(np.array(x, dtype=float).reshape(-1, 2), True) for x in cells]
    except (ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
        raise InvalidInput("cannot be read", value=str(error), expected=expected, remedy=remedy) from None
    if len(found) != 1:
        raise InvalidInput("number of outlines", value=len(found), expected=expected, remedy=remedy)
    path = without_repeats(found[0][0], closed=found[0][1])
    return FirstPath(path.points - 0.5 * in_json, path.closed)
