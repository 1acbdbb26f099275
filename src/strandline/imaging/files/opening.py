"""A file and its format → an open picture file; any error on a damaged file is one line."""

import hashlib
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Shaped

from strandline.errors import InvalidInput
from strandline.imaging.files.contents import PictureFile, require_pixels
from strandline.imaging.reading import PictureReading
from strandline.readers.problems import refused
from strandline.registry import imported, suggestion

__all__ = ["FORMATS", "PictureReader", "checksum", "listed", "loaded", "opened"]

_PILLOW = "strandline.imaging.files.by_pillow:read_by_pillow"
_TIFF = "strandline.imaging.files.tiff:read_tiff"
_HDF5 = "strandline.imaging.files.hdf5:read_hdf5"

FORMATS: dict[str, str] = {
    ".png": _PILLOW,
    ".jpg": _PILLOW,
    ".jpeg": _PILLOW,
    ".tif": _TIFF,
    ".tiff": _TIFF,
    ".oct": "strandline.imaging.files.thorlabs:read_oct",
    ".h5": _HDF5,
    ".hdf5": _HDF5,
    ".mat": _HDF5,
    ".npy": "strandline.imaging.files.npy:read_npy",
}
"""Suffix of a file → ``module:name`` of the function that reads it."""
PictureReader = Callable[[Path, PictureReading, str], PictureFile]
"""(path, how to read it, its name in messages) → the open file."""
T = TypeVar("T")


@contextmanager
def opened(path: Path, how: PictureReading) -> Iterator[PictureFile]:
    """Open a picture file, and close it at the end.

    Args:
        path: Path of the file.
        how: How to read it.

    Raises:
        Unreadable: It is missing, damaged, too large or of an unknown format.
        InvalidInput: An optional package is missing.
    """
    name = path.name
    if not path.is_file():
        there = sorted(one.name for one in path.parent.glob("*") if one.suffix.lower() in FORMATS)
        remedy = suggestion(name, there, "Correct the name of the file in study.yaml, or the file.")
        raise refused(f"{name} is missing", str(path), "a picture file", remedy, kind="result_missing")
    target = how.reader or FORMATS.get(path.suffix.lower())
    if target is None:
        remedy = "Save it as TIFF or PNG, or give `reader: module:name`."
        raise refused(f"{name} has an unknown format", path.suffix or "no suffix", ", ".join(FORMATS), remedy)
    reader: Callable[[Path, PictureReading, str], object] = imported(target, f"reader of {name}")
    file = _guarded(lambda: reader(path, how, name), name)
    if not isinstance(file, PictureFile):
        expected = "strandline.imaging.files.contents.PictureFile"
        raise refused(f"what the reader {target} returns", f"a {type(file).__name__}", expected, "Correct the reader.")
    try:
        require_pixels(name, *file.shape)
        require_pixels(name, max(file.frames, 0))
        yield file
    finally:
        file.close()


def loaded(file: PictureFile, frame: int, name: str) -> Shaped[np.ndarray, "row column *channel"]:
    """Return the numbers of a frame.

    Args:
        file: File that is open.
        frame: Number of the frame, from 0.
        name: Name of the file in messages.

    Raises:
        Unreadable: The file is damaged.
    """
    values = _guarded(lambda: np.asarray(file.load(frame)), name)
    if values.shape[:2] != file.shape:
        raise refused(f"{name}: frame {frame}", f"the shape {values.shape}", f"rows and columns {file.shape}")
    return values


def _guarded(read: Callable[[], T], name: str) -> T:
    """Return what `read` does; any error on a damaged file becomes one line."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return read()
    except InvalidInput:
        raise
    except (Exception, SystemExit) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        remedy = "Look at the file, or at what writes it."
        if "imagecodecs" in reason:
            remedy = "Save it without this compression, or install what unpacks it: pip install imagecodecs"
        raise refused(f"{name} cannot be read", reason, "a whole picture file", remedy) from None


def listed(paths: Path | Sequence[Path]) -> list[Path]:
    """Return the files as a list.

    Args:
        paths: Path of a file or a folder, or of several; a folder stands for the pictures in it, in the order of their
            names.

    Raises:
        Unreadable: There is none, or one that is named twice and would count twice.
    """
    files = [file for path in ([paths] if isinstance(paths, Path) else paths) for file in _pictures(path)]
    twice = next((path.name for path in files if files.count(path) > 1), None)
    if not files or twice is not None:
        found = twice or "no file"
        raise refused("files of a picture", found, "one file, or several, each once", "Correct the list.")
    return files


def _pictures(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    found = sorted(one for one in path.iterdir() if one.suffix.lower() in FORMATS and not one.name.startswith("."))
    if not found:
        raise refused(f"folder {path.name}", "no picture in it", f"files {', '.join(FORMATS)}", "Correct its name.")
    return found


def checksum(files: Sequence[Path]) -> str:
    """Return the SHA-256 checksum of a file, or of the checksums of several one after the other.

    Args:
        files: Paths of the files.

    Raises:
        Unreadable: A file cannot be read.
    """
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
