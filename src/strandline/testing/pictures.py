"""Conformance suite for readers of pictures, ``module:name`` in ``image: {reader: …}``.

Each check takes the path of an intact file and how to read it.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from strandline.imaging import PictureReading, read_picture
from strandline.testing import checks_of
from strandline.testing.readers import require_refused


def check_it_returns_a_picture(path: Path, how: PictureReading) -> None:
    """The file holds rows and columns of finite grey values that differ, and pixels have a size."""
    picture = read_picture(path, how)
    assert picture.values.ndim == 2, f"an array of {picture.values.ndim} dimensions"
    assert np.ptp(picture.values) > 0, "all pixels are the same"
    assert min(picture.pixel) > 0, f"pixels of {picture.pixel} mm"


def check_it_repeats_itself(path: Path, how: PictureReading) -> None:
    """Reading changes nothing: a second time yields the same picture, and the file stays as it is."""
    before = path.read_bytes()
    first, second = (read_picture(path, how) for _ in range(2))
    assert np.array_equal(first.values, second.values), "the second time gives other grey values"
    assert first.pixel == second.pixel, "the second time gives another size of a pixel"
    assert path.read_bytes() == before, "the file has changed"


def check_a_damaged_file_is_refused(path: Path, how: PictureReading) -> None:
    """An empty file and half a file are refused in one line."""
    content = path.read_bytes()
    for what, left in (("an empty file", b""), ("half a file", content[: len(content) // 2])):
        require_refused(what, path.name, left, partial(read_picture, how=how))


CHECKS: dict[str, Callable[[Path, PictureReading], None]] = checks_of(globals())
