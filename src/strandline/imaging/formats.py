"""Readers of picture files: PNG, JPEG, NumPy arrays, HDF5, MATLAB 7.3, Thorlabs .oct and TIFF.

A Thorlabs scan is a zip archive with Header.xml and the intensity as raw 32-bit numbers, depth running fastest. TIFF,
of 8 and 16 bits or floating point, in stacks, by ImageJ or with OME's header, is read by tifffile.
"""

import importlib
import json
import logging
import math
import struct
import zipfile
import zlib
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float32, Shaped

from strandline.foundations import of_extra, suggestion
from strandline.imaging.picture import PictureFile, PictureReading, PixelSize, require_pixels
from strandline.readers import refused

READERS = {".png": ("PIL.PngImagePlugin", "PngImageFile")}
"""Suffix → module and class of Pillow; other suffixes are JPEG. `PIL.Image.open` has another bound of the size."""
PLAIN = ("1", "L", "I", "I;16", "I;16B", "F", "LA", "RGB", "RGBA")
"""Pillow's modes of pictures whose numbers are intensities."""
ORIENTATION = 0x0112
MOST_LISTED = 8
"""Datasets that a message names."""


def read_by_pillow(path: Path, how: PictureReading, name: str) -> PictureFile:
    """Return the picture in a PNG or JPEG file, turned as its EXIF orientation says."""
    module, kind = READERS.get(path.suffix.lower(), ("PIL.JpegImagePlugin", "JpegImageFile"))
    opened = getattr(importlib.import_module(module), kind)
    with path.open("rb") as file, opened(file) as image:
        require_pixels(name, image.height, image.width)
        notes = _notes(image, path)
        values = np.asarray(_upright(image, name))
    return PictureFile((values.shape[0], values.shape[1]), lambda frame: values, notes=notes)


def _upright(image: Any, name: str) -> Any:
    """Return the picture as viewers show it, its palette replaced by colours."""
    if image.mode in ("P", "PA"):
        image = image.convert("RGB")
    if image.mode not in PLAIN:
        remedy = "Save it in grey, or in red, green and blue."
        raise refused(f"{name} has unusual colours", image.mode, "grey, or red, green and blue", remedy)
    operations = importlib.import_module("PIL.ImageOps")
    return operations.exif_transpose(image)


def _notes(image: Any, path: Path) -> tuple[str, ...]:
    notes = []
    turned = image.getexif().get(ORIENTATION, 1)
    if turned in range(2, 9):
        notes.append(f"turned or mirrored as its EXIF orientation {turned} says, like viewers show it")
    if image.mode in ("P", "PA"):
        notes.append("palette replaced by its colours")
    if getattr(image, "is_animated", False):
        notes.append(f"an animation of {image.n_frames} frames; its first frame is read")
    with path.open("rb") as file:
        header = file.read(25)  # of a PNG file, with the bits of a channel at its end
    if path.suffix.lower() == ".png" and image.mode in ("LA", "RGB", "RGBA") and header[24] == 16:
        notes.append("16-bit colours read with 8 bits each; a TIFF keeps them all")
    return tuple(notes)


def read_npy(path: Path, how: PictureReading, name: str) -> PictureFile:
    """Return the picture in an array of numbers; pickled objects are not read.

    The last of three axes is that of colours if it has 3 or 4 entries and the others have more.
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


def read_hdf5(path: Path, how: PictureReading, name: str) -> PictureFile:
    """Return the picture in a dataset of numbers."""
    h5py = importlib.import_module("h5py")
    if not h5py.is_hdf5(path):
        with path.open("rb") as stream:
            found = f"a file that begins with {stream.read(16)!r}"
        what, remedy = f"{name} is no HDF5 file", "In MATLAB, save it with the option '-v7.3'."
        raise refused(what, found, "a whole HDF5 file, or one that MATLAB saved as version 7.3", remedy)
    with ExitStack() as stack:
        return _opened_hdf5(stack.enter_context(h5py.File(path, "r")), h5py, how, name, stack)


def _opened_hdf5(file: Any, h5py: Any, how: PictureReading, name: str, stack: ExitStack) -> PictureFile:
    key, notes = _dataset(file, h5py, how.dataset, name)
    values = file[key]
    if values.is_virtual or values.external:
        expected, remedy = "an array in the file itself", "Save it in one file."
        raise refused(f"{name}: {key} refers to other files", key, expected, remedy)
    if values.size and not values.id.get_storage_size():
        raise refused(f"{name}: {key} was never written", "no numbers", "an array with its numbers")
    reversed_axes = "MATLAB_class" in values.attrs
    channels = _channels(values, name)
    plane = values.shape[: values.ndim - (channels > 0)]
    columns, rows = plane[-2:] if reversed_axes else plane[:-3:-1]
    require_pixels(name, rows, columns)
    leading = plane[:-2]

    def load(frame: int) -> Any:
        found = np.asarray(values[np.unravel_index(frame, leading)] if leading else values[()])
        found = found[..., 0] if channels == 1 else found
        return found.T if reversed_axes else found

    if reversed_axes:
        notes = (*notes, "axes of the MATLAB array turned back to (row, column)")
    axes = tuple((f"axis {k}", length) for k, length in enumerate(leading) if length != 1)
    return PictureFile((rows, columns), load, axes, notes=notes, close=stack.pop_all().close)


def _channels(values: Any, name: str) -> int:
    """Return the number of channels along the last axis, 0 if it is another; ilastik and others name the axes."""
    tags = json.loads(values.attrs.get("axistags", "{}")).get("axes", ())
    axes = [tag["key"] for tag in tags] or [axis.label.lower()[:1] for axis in values.dims]
    number = int(values.shape[-1]) if axes[-1:] == ["c"] else 0
    if number not in (0, 1, 3) or ("y" in axes and [axis for axis in axes if axis != "c"][-2:] != ["y", "x"]):
        shape = " × ".join(map(str, values.shape))
        expected = "rows y, columns x, then nothing, 1 channel or 3 colours"
        raise refused(f"{name}: axes {''.join(axes)}", shape, expected, "Save one channel, its axes as yx or zyx.")
    return number


def _dataset(file: Any, h5py: Any, asked: str | None, name: str) -> tuple[str, tuple[str, ...]]:
    """Return the name of the dataset and a note if the study does not name it."""
    found: list[str] = []

    def visit(key: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.ndim >= 2 and item.dtype.kind in "fiub":
            found.append(key)

    file.visititems(visit)
    key = (asked or "").strip("/")
    if asked is None and len(found) == 1:
        return found[0], (f"array {found[0]}, the only one in the file",)
    if key in found:
        return key, (f"array {key}",)
    listed = ", ".join(found[:MOST_LISTED]) + (", …" if len(found) > MOST_LISTED else "")
    if not found:
        raise refused(f"{name} holds no picture", asked, "a dataset of numbers with two or more axes")
    if asked is None:
        remedy = f"Add `dataset: {found[0]}` or another to the picture."
        raise refused(f"{name} holds several arrays", listed, "the name of one of them", remedy)
    raise refused(f"{name} has no array {asked}", asked, f"one of {listed}", suggestion(asked, found, "Choose one."))


HEADER, INTENSITY = "Header.xml", "data/Intensity.data"
LARGEST_HEADER = 1 << 24
"""Bytes of the header that are read."""


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
        return _opened_oct(stack.enter_context(zipfile.ZipFile(path)), how, name, stack)


def _opened_oct(archive: zipfile.ZipFile, how: PictureReading, name: str, stack: ExitStack) -> PictureFile:
    members = {info.filename.replace("\\", "/"): info for info in archive.infolist()}
    if HEADER not in members or INTENSITY not in members:
        listed = ", ".join(sorted(members)[:8])
        raise refused(f"{name} holds no intensity", listed, f"{HEADER} and {INTENSITY}", "Save the processed data.")
    header = _header(archive, members[HEADER], name)
    columns, rows, frames = (_length(header, axis, name) for axis in "XZY")
    require_pixels(name, rows, columns)
    frame_bytes = 4 * rows * columns
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
    size = header.findtext(f"Image/SizePixel/Size{axis}", "1" if axis == "Y" else "")
    found = _entry(header).get(f"Size{axis}", size)
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
        expected = "`index` in the study, for the header leaves open whether its depths are already divided by it"
        remedy = f"Add `index: {float(stated):g}` if depths are optical paths, or `index: 1` if they are divided."
        raise refused(f"{name} states a refractive index", stated, expected, remedy)
    return (f"the header states the refractive index {float(stated):g}; the study's is used",)


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
        return _opened_tiff(file, path, name, stack)


def _opened_tiff(file: Any, path: Path, name: str, stack: ExitStack) -> PictureFile:
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
    several, white = len(file.series) > 1, page.photometric == MIN_IS_WHITE
    notes = [f"the first of {len(file.series)} series of pictures in the file"] if several else []
    notes += ["0 is white in this file: turned so that high numbers are bright"] if white else []
    return PictureFile((rows, columns), load, axes, size, tuple(notes), stack.pop_all().close)


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
