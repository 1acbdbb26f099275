"""NumPy arrays: (row, column), (row, column, channel) or (frame, …, row, column)."""

from pathlib import Path
from typing import Any

import numpy as np

from strandline.imaging.files.contents import PictureFile, require_pixels
from strandline.imaging.reading import PictureReading
from strandline.readers.problems import refused

__all__ = ["read_npy"]


def read_npy(path: Path, how: PictureReading, name: str) -> PictureFile:
    """Return the picture in an array of numbers; pickled objects are not read.

    The last of three axes is that of colours if it has 3 or 4 entries and the others have more.

    Raises:
        Unreadable: The array has fewer than two axes, or is too large.
        ValueError: A damaged file, or one of another kind.
    """
    values: Any = np.lib.format.open_memmap(path, mode="r")
    if values.ndim < 2:
        found = f"the shape {values.shape}"
        raise refused(f"{name} holds no picture", found, "an array (row, column) saved by numpy.save")
    coloured = values.ndim == 3 and values.shape[-1] in (3, 4) and min(values.shape[:2]) > 4
    if coloured:
        values = values[None]
    rows, columns = values.shape[1:3] if coloured else values.shape[-2:]
    require_pixels(name, rows, columns)
    leading = values.shape[: 1 if coloured else -2]
    axes = tuple((f"axis {k}", length) for k, length in enumerate(leading) if length != 1)
    return PictureFile((rows, columns), lambda frame: np.array(values[np.unravel_index(frame, leading)]), axes)
