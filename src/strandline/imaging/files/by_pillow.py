"""PNG and JPEG, read by Pillow; neither states the size of a pixel, for their dots per inch mean nothing."""

import importlib
from pathlib import Path
from typing import Any

import numpy as np

from strandline.imaging.files.contents import PictureFile, require_pixels
from strandline.imaging.reading import PictureReading
from strandline.readers.problems import refused

__all__ = ["read_by_pillow"]

READERS = {".png": ("PIL.PngImagePlugin", "PngImageFile")}
"""Suffix → module and class of Pillow; other suffixes are JPEG. `PIL.Image.open` has another bound of the size."""
PLAIN = ("1", "L", "I", "I;16", "I;16B", "F", "LA", "RGB", "RGBA")
"""Pillow's modes of pictures whose numbers are intensities."""
ORIENTATION = 0x0112


def read_by_pillow(path: Path, how: PictureReading, name: str) -> PictureFile:
    """Return the picture in a PNG or JPEG file, turned as its EXIF orientation says.

    Raises:
        Unreadable: It is too large, or its colours are neither grey nor red, green and blue.
        OSError: (also SyntaxError, ValueError) a damaged file, or one of another kind.
    """
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
    """Return what the reader changes."""
    notes = []
    turned = image.getexif().get(ORIENTATION, 1)
    if turned in range(2, 9):
        notes.append(f"turned or mirrored as its EXIF orientation {turned} says, like viewers show it")
    if image.mode in ("P", "PA"):
        notes.append("palette replaced by its colours")
    if getattr(image, "is_animated", False):
        notes.append(f"an animation of {image.n_frames} frames; its first frame is read")
    if path.suffix.lower() == ".png" and image.mode in ("LA", "RGB", "RGBA") and _bits(path) == 16:
        notes.append("16-bit colours read with 8 bits each; a TIFF keeps them all")
    return tuple(notes)


def _bits(path: Path) -> int:
    """Return the bits of a channel that the header of a PNG file states."""
    with path.open("rb") as file:
        return file.read(25)[24]
