"""TIFF: 8 and 16 bits, floating point, stacks, ImageJ and OME, read by tifffile."""

import importlib
import logging
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped

from strandline.errors import InvalidInput
from strandline.imaging.files.contents import PictureFile, require_pixels
from strandline.imaging.files.tiff_pages import require_parts, require_whole_chain
from strandline.imaging.files.tiff_scale import stated_size
from strandline.imaging.reading import PictureReading
from strandline.readers.problems import refused

__all__ = ["read_tiff"]

MIN_IS_WHITE, MIN_IS_BLACK, RGB = 0, 1, 2
"""TIFF's numbers of the ways in which a number becomes a colour."""
JPEG_COLOURS = (6, 7)
"""Colours and compression of a JPEG within a TIFF, which become red, green and blue."""
LARGEST_TILE = 1 << 28
"""Most numbers in a tile, which is decoded in one piece."""


def read_tiff(path: Path, how: PictureReading, name: str) -> PictureFile:
    """Return the first series of pictures in a TIFF file.

    Raises:
        InvalidInput: tifffile is not installed.
        Unreadable: The picture is too large, or its numbers are no intensities.
        ValueError: (also EOFError, OSError) a damaged file, or one of another kind.
    """
    tifffile = _imported(name)
    require_whole_chain(path)
    file = tifffile.TiffFile(path)
    try:
        return _opened(file, path, name)
    except BaseException:
        file.close()
        raise


def _opened(file: Any, path: Path, name: str) -> PictureFile:
    series = file.series[0]
    page, shape = series.keyframe, dict(zip(series.axes, series.shape, strict=True))
    rows, columns = shape["Y"], shape["X"]
    require_pixels(name, rows, columns, page.samplesperpixel)
    if page.is_tiled and page.tilelength * page.tilewidth > LARGEST_TILE:
        raise refused(f"{name} has tiles that are too large", f"{page.tilelength} × {page.tilewidth}", "smaller tiles")
    _require_intensities(series, page, name)
    axes = tuple((axis, length) for axis, length in shape.items() if axis not in "YXS" and length != 1)
    return PictureFile(
        (rows, columns),
        _Frames(series, path, file.byteorder),
        axes,
        stated_size(file, page),
        _notes(file, page),
        file.close,
    )


class _Frames:
    """Frames of a series by their number."""

    def __init__(self, series: Any, path: Path, byteorder: str) -> None:
        self.series, self.path, self.byteorder = series, path, byteorder
        self.page = series.keyframe

    def __call__(self, frame: int) -> Shaped[np.ndarray, "row column *channel"]:
        """Return a frame, channels last, high numbers bright."""
        values = self._stored(frame)
        if self.page.samplesperpixel > 1 and self.page.axes.startswith("S"):
            values = np.moveaxis(values, 0, -1)
        if self.page.photometric == MIN_IS_WHITE and values.dtype.kind in "bu":
            values = (2**self.page.bitspersample - 1) - values.astype(np.int64)
        return values

    def _stored(self, frame: int) -> Shaped[np.ndarray, "..."]:
        """Return a frame as it is stored; ImageJ writes one page for a stack above 4 GB."""
        shape = self.page.shape
        count = self.series.size // self.page.size
        if count == len(self.series.pages) or self.series.dataoffset is None:
            page = self.series.pages[frame]
            require_parts(self.path, page)
            return np.asarray(page.asarray())
        kind = np.dtype(self.byteorder + self.series.dtype.char)
        whole = np.memmap(self.path, kind, "r", self.series.dataoffset, (count, *shape))
        return np.array(whole[frame])


def _require_intensities(series: Any, page: Any, name: str) -> None:
    """Refuse several files, palettes, printers' colours and other numbers that are no intensities."""
    if series.is_multifile:
        raise refused(f"{name} refers to other files", "a series in several files", "one file", "Save it as one file.")
    photometric = int(page.photometric) if page.photometric is not None else MIN_IS_BLACK
    if photometric not in (MIN_IS_WHITE, MIN_IS_BLACK, RGB) and (photometric, page.compression) != JPEG_COLOURS:
        remedy = "Save it in grey, or in red, green and blue."
        raise refused(f"{name} has unusual colours", page.photometric.name, "grey, or red, green and blue", remedy)


def _notes(file: Any, page: Any) -> tuple[str, ...]:
    notes = []
    if len(file.series) > 1:
        notes.append(f"the first of {len(file.series)} series of pictures in the file")
    if page.photometric == MIN_IS_WHITE:
        notes.append("0 is white in this file: turned so that high numbers are bright")
    return tuple(notes)


def _imported(name: str) -> Any:
    """Return tifffile; what it logs about a damaged file stays off the screen, for the error says it.

    Raises:
        InvalidInput: It is not installed.
    """
    try:
        tifffile = importlib.import_module("tifffile")
    except ModuleNotFoundError:
        raise InvalidInput(
            f"{name} needs tifffile",
            value="no package of this name",
            expected="the extra `image`",
            remedy='Install it: pip install "strandline[image]"',
        ) from None
    log = logging.getLogger("tifffile")
    if not log.handlers:
        log.addHandler(logging.NullHandler())
    return tifffile
