"""Thorlabs .oct: a zip archive with Header.xml and the intensity as raw 32-bit numbers, depth running fastest."""

import zipfile
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float32

from strandline.imaging.picture import PictureFile, require_pixels
from strandline.imaging.reading import PictureReading, PixelSize
from strandline.readers import refused

HEADER, INTENSITY = "Header.xml", "data/Intensity.data"
LARGEST_HEADER = 1 << 24
"""Bytes of the header that are read."""
BYTES = 4
"""Bytes of a number."""


def read_oct(path: Path, how: PictureReading, name: str) -> PictureFile:
    """Return the intensity of a scan: rows run along the depth, columns along x, frames along y.

    The programs of the maker store decibels; the header does not say so, nor whether depths are already divided by a
    refractive index. So the study must state the scale, and the index where the header has one.
    """
    if not zipfile.is_zipfile(path):
        raise refused(f"{name} is no Thorlabs scan", "a file that is no whole zip archive", "a whole .oct file")
    if how.scale is None:
        expected = "the scale of its numbers, which its header does not state"
        raise refused(f"{name} needs `scale`", None, expected, "Add `scale: dB`, which the maker's programs write.")
    with ExitStack() as stack:
        return _opened(stack.enter_context(zipfile.ZipFile(path)), how, name, stack)


def _opened(archive: zipfile.ZipFile, how: PictureReading, name: str, stack: ExitStack) -> PictureFile:
    members = {info.filename.replace("\\", "/"): info for info in archive.infolist()}
    if HEADER not in members or INTENSITY not in members:
        listed = ", ".join(sorted(members)[:8])
        raise refused(f"{name} holds no intensity", listed, f"{HEADER} and {INTENSITY}", "Save the processed data.")
    header = _header(archive, members[HEADER], name)
    columns, rows, frames = (_length(header, axis, name) for axis in "XZY")
    require_pixels(name, rows, columns)
    frame_bytes = BYTES * rows * columns
    if members[INTENSITY].file_size != frames * frame_bytes:
        expected = f"{frames * frame_bytes}, for {rows} × {columns} × {frames} numbers"
        raise refused(f"{name} has an intensity of another length", members[INTENSITY].file_size, expected)
    notes = _index_notes(header, how, name)
    stream = stack.enter_context(archive.open(members[INTENSITY]))

    def load(frame: int) -> Float32[np.ndarray, "row column"]:
        stream.seek(frame * frame_bytes)
        content = stream.read(frame_bytes)
        if len(content) < frame_bytes:
            raise EOFError("its intensity is cut off")
        return np.frombuffer(content, dtype="<f4").reshape(columns, rows).T

    axes = (("y", frames),) if frames > 1 else ()
    size = _size(header, rows, columns, frames)
    return PictureFile((rows, columns), load, axes, size, notes, stack.pop_all().close)


def _header(archive: zipfile.ZipFile, info: zipfile.ZipInfo, name: str) -> ElementTree.Element:
    """Return the header; one with entities of its own is refused, for they can grow without end."""
    with archive.open(info) as file:
        content = file.read(LARGEST_HEADER + 1)
    if len(content) > LARGEST_HEADER or b"<!DOCTYPE" in content:
        raise refused(f"{name} has a header that cannot be read", f"{len(content)} bytes", "a header of the maker")
    return ElementTree.fromstring(content)


def _entry(header: ElementTree.Element) -> Any:
    """Return the attributes of the intensity in the list of data files."""
    for entry in header.iter("DataFile"):
        if (entry.text or "").strip().replace("\\", "/") == INTENSITY:
            return entry.attrib
    return {}


def _length(header: ElementTree.Element, axis: str, name: str) -> int:
    """Return the number of pixels along an axis; a single picture may lack that of y."""
    found = _entry(header).get(
        f"Size{axis}", header.findtext(f"Image/SizePixel/Size{axis}", "1" if axis == "Y" else "")
    )
    if not (found.isascii() and found.isdigit() and len(found) < 10 and int(found) > 0):
        raise refused(f"{name}: Size{axis} in its header", found, "a number of pixels")
    return int(found)


def _size(header: ElementTree.Element, rows: int, columns: int, frames: int) -> PixelSize | None:
    """Return the size of a pixel from the ranges in mm; None if the header lacks them."""
    entry = _entry(header)
    lengths = {axis: entry.get(f"Range{axis}", header.findtext(f"Image/SizeReal/Size{axis}")) for axis in "XZY"}
    if lengths["X"] is None or lengths["Z"] is None:
        return None
    apart = float(lengths["Y"]) / frames if frames > 1 and lengths["Y"] is not None else None
    return PixelSize(float(lengths["X"]) / columns, float(lengths["Z"]) / rows, apart, "the header of the scan")


def _index_notes(header: ElementTree.Element, how: PictureReading, name: str) -> tuple[str, ...]:
    """Return a note on the refractive index in the header; refuse a study that leaves open what it means."""
    stated = header.findtext("Acquisition/RefractiveIndex")
    if stated is None or abs(float(stated) - 1) < 1e-6:
        return ()
    if how.index is None:
        raise refused(
            f"{name} states a refractive index",
            stated,
            "`index` in the study, for the header leaves open whether its depths are already divided by it",
            f"Add `index: {float(stated):g}` if depths are optical paths, or `index: 1` if they are divided.",
        )
    return (f"the header states the refractive index {float(stated):g}; the study's is used",)
