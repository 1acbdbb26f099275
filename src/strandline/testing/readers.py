"""Conformance suite for readers of files: what any entry of `strandline.readers.READERS` must do.

Each check takes the path of an intact file and how to read it.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from strandline.readers import Reading, Unreadable, read_interface
from strandline.testing import checks_of


def check_it_returns_an_interface(path: Path, how: Reading) -> None:
    """The file holds an interface of finite points."""
    points = read_interface(path, how).points
    assert len(points) > 1, f"an interface of {len(points)} point"
    assert np.isfinite(points).all(), "a point is not finite"


def check_it_repeats_itself(path: Path, how: Reading) -> None:
    """Reading changes nothing: a second time yields the same interface, and the file stays as it is."""
    before = path.read_bytes()
    first, second = (read_interface(path, how) for _ in range(2))
    assert np.array_equal(first.points, second.points), "the second time gives other points"
    assert np.array_equal(first.cells, second.cells), "the second time gives other cells"
    assert path.read_bytes() == before, "the file has changed"


def check_the_unit_counts(path: Path, how: Reading) -> None:
    """Read in µm, the interface has a thousandth of its size in mm."""
    large, small = (read_interface(path, replace(how, unit=unit)).points for unit in ("mm", "um"))
    assert np.allclose(1e-3 * large, small, rtol=1e-12), "the unit makes no difference of a thousand"


def check_a_damaged_file_is_refused(path: Path, how: Reading) -> None:
    """An empty file, half a file and one of random bytes are refused as unreadable, in one line."""
    content, number = path.read_bytes(), len(read_interface(path, how).points)
    noise = np.random.default_rng(1).bytes(max(len(content), 1000))
    counted = replace(how, count=how.count or number)
    damaged = {"an empty file": (b"", how), "a file of random bytes": (noise, how)}
    damaged["half a file, whose points are counted,"] = content[: len(content) // 2], counted
    for what, (left, by) in damaged.items():
        require_refused(what, path.name, left, partial(read_interface, how=by))


def require_refused(what: str, name: str, content: bytes, read: Callable[[Path], object]) -> None:
    """Require that `read` refuses a file of this name and content as unreadable, in one line."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(content)
        try:
            read(path)
        except Unreadable as error:
            complaint = str(error)
        else:
            raise AssertionError(f"{what} is read")
    assert "\n" not in complaint, f"{what} is refused in several lines"


CHECKS: dict[str, Callable[[Path, Reading], None]] = checks_of(globals())
