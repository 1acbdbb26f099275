"""TIFF: 8 and 16 bits, floating point, stacks, ImageJ and OME, read by tifffile."""

import logging
import math
import struct
import zlib
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Shaped

from strandline.foundations import of_extra
from strandline.imaging.picture import PictureFile, PictureReading, PixelSize, require_pixels
from strandline.readers import refused

MIN_IS_WHITE, MIN_IS_BLACK, RGB = 0, 1, 2
"""TIFF's numbers of the ways in which a number becomes a colour."""
JPEG_COLOURS = (6, 7)
"""Colours and compression of a JPEG within a TIFF, which become red, green and blue."""
LARGEST_TILE = 1 << 28
"""Most numbers in a tile, which is decoded in one piece."""
MOST_PAGES = 1_000_000
DEFLATE = (8, 32946)
"""TIFF's numbers of the compression by zlib, the only one that unpacks without a bound of its own."""
MOST_UNPACKED = 1 << 28
"""Bytes; what cannot unpack to more, at zlib's largest ratio, is not looked at before."""
LARGEST_RATIO = 1032
_MICROMETRES = ("um", "µm", "μm", "\\u00B5m", "micron", "microns", "micrometer")
TO_MM = {"nm": 1e-6, "mm": 1.0, "cm": 10.0, "m": 1e3, "inch": 25.4, "in": 25.4} | dict.fromkeys(_MICROMETRES, 1e-3)
"""Units as ImageJ and OME write them; both ways to write µ occur, and its code."""


def read_tiff(path: Path, how: PictureReading, name: str) -> PictureFile:
    """Return the first series of pictures in a TIFF file."""
    tifffile = of_extra("tifffile", "image", f"{name} needs tifffile")
    log = logging.getLogger("tifffile")
    if not log.handlers:  # what it logs about a damaged file stays off the screen, for the error says it
        log.addHandler(logging.NullHandler())
    with ExitStack() as stack:
        file = stack.enter_context(tifffile.TiffFile(path))
        require_whole_chain(file)
        return _opened(file, path, name, stack)


def _opened(file: Any, path: Path, name: str, stack: ExitStack) -> PictureFile:
    series = file.series[0]
    page, shape = series.keyframe, dict(zip(series.axes, series.shape, strict=True))
    rows, columns = shape["Y"], shape["X"]
    require_pixels(name, rows, columns, page.samplesperpixel)
    if page.is_tiled and page.tilelength * page.tilewidth > LARGEST_TILE:
        raise refused(f"{name} has tiles that are too large", f"{page.tilelength} × {page.tilewidth}", "smaller tiles")
    _require_intensities(series, page, name)
    axes = tuple((axis, length) for axis, length in shape.items() if axis not in "YXS" and length != 1)

    def load(frame: int) -> Shaped[np.ndarray, "row column *channel"]:
        """Return a frame, channels last, high numbers bright."""
        values = _stored(series, frame, path, file.byteorder)
        if page.samplesperpixel > 1 and page.axes.startswith("S"):
            values = np.moveaxis(values, 0, -1)
        if page.photometric == MIN_IS_WHITE and values.dtype.kind in "bu":
            values = (2**page.bitspersample - 1) - values.astype(np.int64)
        return values

    header = file.imagej_metadata or {}
    size = _of_ome(file.ome_metadata) if file.is_ome else _of_imagej(header, page) if file.is_imagej else None
    return PictureFile((rows, columns), load, axes, size, _notes(file, page), stack.pop_all().close)


def _stored(series: Any, frame: int, path: Path, byteorder: str) -> Shaped[np.ndarray, "..."]:
    """Return a frame as it is stored; ImageJ writes one page for a stack above 4 GB."""
    count = series.size // series.keyframe.size
    if count == len(series.pages) or series.dataoffset is None:
        page = series.pages[frame]
        require_parts(path, page)
        return np.asarray(page.asarray())
    kind = np.dtype(byteorder + series.dtype.char)
    return np.array(np.memmap(path, kind, "r", series.dataoffset, (count, *series.keyframe.shape))[frame])


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


def _of_ome(header: str) -> PixelSize | None:
    """Return the size in the first ``Pixels`` of an OME header, whose unit is µm unless it names another."""
    if "<!DOCTYPE" in header:
        return None
    pixels = next((e for e in ElementTree.fromstring(header).iter() if e.tag.rpartition("}")[2] == "Pixels"), None)
    if pixels is None:
        return None
    x, y, z = (_physical(pixels, axis) for axis in "XYZ")
    return None if x is None or y is None else PixelSize(x, y, z, "the OME header")


def _physical(pixels: ElementTree.Element, axis: str) -> float | None:
    size = pixels.get(f"PhysicalSize{axis}")
    factor = TO_MM.get(pixels.get(f"PhysicalSize{axis}Unit", "µm"))
    return None if size is None or factor is None else factor * float(size)


def _of_imagej(header: dict[str, Any], page: Any) -> PixelSize | None:
    """Return the size from pixels per unit in the resolution tags, the unit from the description of ImageJ."""
    unit = header.get("unit", "")
    x, y, z = (TO_MM.get(str(header.get(name, unit))) for name in ("unit", "yunit", "zunit"))
    across, along = (_per_pixel(page, f"{axis}Resolution") for axis in "XY")
    if x is None or y is None or across is None or along is None:
        return None
    spacing = abs(float(header.get("spacing") or 0))
    return PixelSize(x * across, y * along, z * spacing if z and spacing else None, "the ImageJ header")


def _per_pixel(page: Any, tag: str) -> float | None:
    """Return units per pixel from a fraction of pixels per unit."""
    found = page.tags.get(tag)
    if found is None or 0 in found.value:
        return None
    above, below = found.value
    return float(below / above)


def require_whole_chain(file: Any) -> None:
    """Refuse a file one of whose pages lies beyond its end, so that it is cut off, or whose pages lie in a circle."""
    form, handle, seen = file.tiff, file.filehandle, set[int]()
    offset = file.pages.first.offset
    while offset:
        if offset in seen or len(seen) == MOST_PAGES:
            raise ValueError("its pages lie in a circle")
        seen.add(offset)
        try:
            handle.seek(offset)
            (count,) = struct.unpack(form.tagnoformat, handle.read(form.tagnosize))
            handle.seek(count * form.tagsize, 1)
            (offset,) = struct.unpack(form.offsetformat, handle.read(form.offsetsize))
        except struct.error:
            raise EOFError("the file is cut off, or a page lies beyond its end") from None


def require_parts(path: Path, page: Any, *, most: int = MOST_UNPACKED) -> None:
    """Refuse a page that lacks strips or tiles, which tifffile fills with 0, or that unpacks to much more than it is.

    `path`: path of the file; `page`: page that tifffile read; `most`: bytes to which each may unpack, if the page is
    not larger.
    """
    expected = math.prod(page.keyframe.chunked)
    found = sum(offset > 0 and count > 0 for offset, count in zip(page.dataoffsets, page.databytecounts, strict=True))
    if found < expected:
        raise EOFError(f"{expected - found} of its {expected} strips or tiles are missing")
    if int(page.compression) not in DEFLATE:
        return
    bound = max(most, 2 * page.nbytes)
    for offset, count in zip(page.dataoffsets, page.databytecounts, strict=True):
        if count * LARGEST_RATIO <= bound:
            continue
        with path.open("rb") as file:
            file.seek(offset)
            packed = file.read(count)
        if len(zlib.decompressobj().decompress(packed, bound + 1)) > bound:
            raise ValueError(f"its {count} compressed bytes unpack to more than its pixels")
