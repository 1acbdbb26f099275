"""A picture file → the picture, linear in intensity, with the size of its pixels."""

import hashlib
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Shaped

from strandline.foundations import imported, suggestion, unfit
from strandline.imaging.formats import read_by_pillow, read_hdf5, read_npy, read_oct, read_tiff
from strandline.imaging.picture import Picture, PictureFile, PictureReading, PixelSize, Stack, agreed, require_pixels
from strandline.readers import refused, undamaged

PictureReader = Callable[[Path, PictureReading, str], PictureFile]
"""(path, how to read it, its name in messages) → the open file."""
FORMATS: dict[str, PictureReader] = {
    **dict.fromkeys((".png", ".jpg", ".jpeg"), read_by_pillow),
    **dict.fromkeys((".tif", ".tiff"), read_tiff),
    **dict.fromkeys((".h5", ".hdf5", ".mat"), read_hdf5),
    ".oct": read_oct,
    ".npy": read_npy,
}
"""Suffix of a file → function that reads it."""
Paths = Path | Sequence[Path]
LUMA = (0.2126, 0.7152, 0.0722)
"""Weights of red, green and blue in grey, Rec. 709."""
COLOURS = ("red", "green", "blue")
MOST_DECIBELS = 200.0
"""Largest range of a picture in decibels; a screen's 8 bits taken for decibels span 255."""
Values = Float[np.ndarray, "row column"]
Raw = Shaped[np.ndarray, "row column *channel"]
_VOXEL = "e.g. `{x: 6, y: 6, z: 10, unit: um}`"


@contextmanager
def opened(path: Path, how: PictureReading) -> Iterator[PictureFile]:
    """Open a picture file, and close it at the end; one that is missing, damaged or too large is refused."""
    name = path.name
    if not os.path.isfile(path):  # noqa: PTH113 - Path.is_file raises for a name that is too long
        near = path.parent.glob("*") if os.path.isdir(path.parent) else ()  # noqa: PTH112
        there = sorted(one.name for one in near if one.suffix.lower() in FORMATS)
        remedy = suggestion(name, there, "Correct the name of the file in study.yaml, or the file.")
        raise refused(f"{name} is missing", str(path), "a picture file", remedy, kind="result_missing")
    reader: Callable[[Path, PictureReading, str], object] | None = FORMATS.get(path.suffix.lower())
    if how.reader is not None:
        reader = imported(how.reader, f"reader of {name}")
    if reader is None:
        remedy = "Save it as TIFF or PNG, or give `reader: module:name`."
        raise refused(f"{name} has an unknown format", path.suffix or "no suffix", ", ".join(FORMATS), remedy)
    with undamaged(name, "a whole picture file"):
        file = reader(path, how, name)
    if not isinstance(file, PictureFile):
        what, expected = f"what the reader {how.reader} returns", "strandline.imaging.PictureFile"
        raise refused(what, f"a {type(file).__name__}", expected, "Correct the reader.")
    try:
        require_pixels(name, *file.shape)
        require_pixels(name, max(file.frames, 0))
        yield file
    finally:
        file.close()


def loaded(file: PictureFile, frame: int, name: str) -> Raw:
    """Return the numbers of a frame."""
    with undamaged(name, "a whole picture file"):
        values = np.asarray(file.load(frame))
    if values.shape[:2] != file.shape:
        raise refused(f"{name}: frame {frame}", f"the shape {values.shape}", f"rows and columns {file.shape}")
    return values


def listed(paths: Path | Sequence[Path]) -> list[Path]:
    """Return the files as a list, each once; a folder stands for the pictures in it, in the order of their names."""
    files = [file for path in ([paths] if isinstance(paths, Path) else paths) for file in _pictures(path)]
    twice = next((path.name for path in files if files.count(path) > 1), None)
    if not files or twice is not None:
        found = twice or "no file"
        raise refused("files of a picture", found, "one file, or several, each once", "Correct the list.")
    return files


def _pictures(path: Path) -> list[Path]:
    if not os.path.isdir(path):  # noqa: PTH112 - Path.is_dir raises for a name that is too long
        return [path]
    found = sorted(one for one in path.iterdir() if one.suffix.lower() in FORMATS and not one.name.startswith("."))
    if not found:
        raise refused(f"folder {path.name}", "no picture in it", f"files {', '.join(FORMATS)}", "Correct its name.")
    return found


def checksum(files: Sequence[Path]) -> str:
    """Return the SHA-256 checksum of a file, or of the checksums of several one after the other."""
    digests = []
    for path in files:
        try:
            with path.open("rb") as file:
                digests.append(hashlib.file_digest(file, "sha256"))
        except OSError as error:
            raise refused(f"{path.name} cannot be read", str(error), "a picture file", kind="result_missing") from None
    if len(digests) == 1:
        return digests[0].hexdigest()
    return hashlib.sha256(b"".join(digest.digest() for digest in digests)).hexdigest()


def read_picture(paths: Paths, how: PictureReading) -> Picture:
    """Return the picture in a file, or the mean of several frames of one state.

    Args:
        paths: Path of the file, or of several files with one frame each; their mean is taken, linear in intensity.
        how: How to read them.

    Raises:
        Unreadable: A file is missing, damaged, too large, not finite, or does not fit the options; frames that differ
            in size.
        InvalidInput: An optional package is missing.
    """
    frames = read_frames(paths, how)
    first = next(frames)
    total, count = first.values, 1
    for frame in frames:
        _require_same(first, frame)
        total = total + frame.values if count == 1 else np.add(total, frame.values, out=total)
        count += 1
    if count == 1:
        return first
    notes = (*first.notes, f"mean of {count} frames")
    files = listed(paths)
    return replace(first, values=total / count, name=_name(files), sha256=checksum(files), notes=notes, frames=count)


def read_frames(paths: Paths, how: PictureReading) -> Iterator[Picture]:
    """Yield the pictures whose mean `read_picture` takes, one at a time.

    Args:
        paths: Path of a file, or of several.
        how: How to read them.

    Raises:
        InvalidInput: As `read_picture`.
    """
    for path in listed(paths):
        with opened(path, how) as file:
            digest = checksum([path])
            size = agreed(how.pixel, file.size, path.name)
            of_size = [f"pixel size {PixelSize(size.x, size.y)} from {size.source}"]
            of_size += [f"index {how.index:g} divides y"] if how.index not in (None, 1) else []
            numbers = range(file.frames) if how.average else (_page(file, how, path.name),)
            who = "the default" if how.page is None else "from the study"
            for k in numbers:
                values, notes = intensity(loaded(file, k, path.name), how, path.name)
                frame = [f"frame {k} of {file.frames}{_layers(file)}, {who}"] if len(numbers) < file.frames else []
                said = (*of_size, *file.notes, *frame, *notes)
                yield Picture(values, (size.x, size.y / (how.index or 1.0)), path.name, digest, said)


def read_stack(paths: Paths, how: PictureReading) -> Stack:
    """Return the stack of pictures in a file, or in several files with one plane each.

    Args:
        paths: Path of a file, or of several in the order of their planes.
        how: How to read them; its pixel size has the distance of the planes unless the header states it.

    Raises:
        InvalidInput: As `read_picture`; a file with one plane, with several axes besides row and column, or without
            the distance of the planes; a page or an average.
    """
    files = listed(paths)
    if how.page is not None or how.average:
        raise unfit("page or average of a stack", how.given, "neither", "A stack takes all its planes.")
    depth, size, source = _extent(files, how)
    pictures = read_frames(files, how if len(files) > 1 else replace(how, average=True))
    first = next(pictures)
    values = np.empty((depth, *first.values.shape))
    values[0] = first.values
    for k, picture in enumerate(pictures, 1):
        _require_same(first, picture)
        values[k] = picture.values
    notes = (f"stack of {depth} planes, {1e3 * size:.6g} µm apart, from {source}", *first.notes)
    return Stack(values, (*first.pixel, size), _name(files), checksum(files), notes)


def _extent(files: Sequence[Path], how: PictureReading) -> tuple[int, float, str]:
    """Return the number of planes, their distance, mm, and who states it."""
    name = files[0].name
    with opened(files[0], how) as file:
        depth = len(files) if len(files) > 1 else file.frames
        if depth == 1 or (len(files) == 1 and (len(file.axes) != 1 or file.axes[0][0] in ("T", "C"))):
            found = _layers(file).strip(" ()") or "one plane"
            raise refused(f"{name} holds no stack", found, "several planes along one axis", "Save one stack in a file.")
        require_pixels(name, depth, *file.shape)
        if how.pixel is None and file.size is None:
            expected = "x, y and z of a voxel in the study, or in the header of the file"
            raise refused(f"{name} does not state the size of a voxel", None, expected, f"Add {_VOXEL}.")
        size = agreed(how.pixel, file.size, name)
    if size.z is None:
        expected = "the distance of the planes of a stack"
        raise refused(f"{name} does not state z", None, expected, f"Add z to the size of a voxel, {_VOXEL}.")
    header = file.size is not None and (how.pixel is None or how.pixel.z is None)
    return depth, size.z, file.size.source if header and file.size is not None else size.source


def _name(files: Sequence[Path]) -> str:
    return files[0].name if len(files) == 1 else f"{files[0].name} and {len(files) - 1} more"


def _page(file: PictureFile, how: PictureReading, name: str) -> int:
    page = how.page or 0
    if page < file.frames:
        return page
    if file.frames == 1:
        raise refused(f"{name} has no such page", page, "0: it has a single one", "Leave `page` out.")
    expected = f"a page from 0 to {file.frames - 1}{_layers(file)}"
    raise refused(f"{name} has no such page", page, expected, "Correct `page`.")


def _layers(file: PictureFile) -> str:
    return f" ({', '.join(f'{axis} {length}' for axis, length in file.axes)})" if len(file.axes) else ""


def _require_same(first: Picture, other: Picture) -> None:
    if first.values.shape != other.values.shape or not np.allclose(first.pixel, other.pixel, rtol=1e-6, atol=0):
        remedy = "Give frames of one camera and scale."
        raise refused(f"{other.name} differs from {first.name}", repr(other), repr(first), remedy)


def intensity(raw: Raw, how: PictureReading, name: str) -> tuple[Values, tuple[str, ...]]:
    """Return the intensity of each pixel, and sentences that say what was done.

    `raw`: numbers of the file, shape (row, column) or (row, column, channel). `how`: how to read the picture; its
    channel and its scale count. `name`: name of the file in messages.
    """
    if raw.dtype.kind not in "fiub":
        raise refused(f"{name} holds no picture", f"numbers of the type {raw.dtype}", "real numbers")
    channels = raw.shape[2] if raw.ndim == 3 else 1
    if raw.ndim not in (2, 3) or channels > 4 or channels < 1:
        raise refused(f"{name} holds no picture", f"the shape {raw.shape}", "grey, or red, green and blue")
    colours = raw[..., None] if raw.ndim == 2 else raw[..., : 1 if channels < 3 else 3]
    notes = ["the alpha channel is left out"] if channels in (2, 4) else []
    values, of_colours = _chosen(colours, how, name)
    return values, (*notes, *of_colours, _scale_note(how.scale, coloured=channels > 2))


def _chosen(colours: Raw, how: PictureReading, name: str) -> tuple[Values, tuple[str, ...]]:
    wanted = how.channel or "grey"
    if colours.shape[2] == 1:
        if wanted != "grey":
            raise refused(f"{name} has no colours", f"channel: {wanted}", "channel: grey", "Remove `channel`.")
        return _linear(colours[..., 0], how.scale, name), ()
    if wanted != "grey":
        return _linear(colours[..., COLOURS.index(wanted)], how.scale, name), (f"the {wanted} channel",)
    total = np.zeros(colours.shape[:2])
    for k, weight in enumerate(LUMA):
        total += weight * _linear(colours[..., k], how.scale, name)
    shares = ", ".join(f"{weight:.4f} {colour}" for weight, colour in zip(LUMA, COLOURS, strict=True))
    return total, (f"RGB converted to grey by Rec. 709 luma: {shares}",)


def _scale_note(scale: str | None, *, coloured: bool) -> str:
    if scale is None:
        advice = "; `scale: sRGB` undoes the code of a camera's colours" if coloured else ""
        return f"grey values taken as intensity, because the study states no scale{advice}"
    return f"scale {scale} from the study" + ("" if scale == "intensity" else ", undone")


def _linear(raw: Shaped[np.ndarray, "row column"], scale: str | None, name: str) -> Values:
    """Return the intensity; pixels that are not finite stay so, but for the logarithm of nothing."""
    values = raw.astype(np.float64)
    if scale == "amplitude":
        if (values < 0).any():
            expected, remedy = "amplitudes from 0", "Correct `scale`."
            raise refused(f"{name} has negative amplitudes", float(values.min()), expected, remedy)
        return values**2
    if scale in ("log10", "dB"):
        return _of_decibels(values if scale == "dB" else 10 * values, name)
    return _of_srgb(values, raw.dtype, name) if scale == "sRGB" else values


def _of_decibels(values: Values, name: str) -> Values:
    """Return 10^(v/10); a range that no detector has is refused."""
    seen = values[values > -np.inf]
    if seen.size and (np.ptp(seen) > MOST_DECIBELS or abs(seen).max() > 10 * MOST_DECIBELS):
        found = f"{seen.min():g} to {seen.max():g} dB"
        remedy = "A picture for the screen has lost its scale: export the numbers, or correct `scale`."
        raise refused(f"{name} has no logarithms of intensities", found, f"a range below {MOST_DECIBELS:g} dB", remedy)
    return np.asarray(10.0 ** (values / 10))


def _of_srgb(values: Values, kind: np.dtype, name: str) -> Values:
    """Return the intensity from 0 to 1 of numbers coded for a screen (IEC 61966-2-1)."""
    coded = values / (np.iinfo(kind).max if kind.kind == "u" else 1)
    if coded.min() < 0 or coded.max() > 1 or kind.kind not in "uf":
        expected = "unsigned whole numbers, or numbers from 0 to 1"
        raise refused(f"{name} is not coded as sRGB", f"{values.min():g} to {values.max():g}", expected)
    return np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)
