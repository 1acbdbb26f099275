"""A file → the interface in it."""

import re
import stat
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float

from strandline.errors import InvalidInput
from strandline.interface import Interface
from strandline.readers.contents import Contents
from strandline.readers.foreign import require_known
from strandline.readers.options import Reading
from strandline.readers.problems import Unreadable, refused
from strandline.readers.shape import interface_of, point_sds, unused_displacement
from strandline.readers.tables import missing, require_end
from strandline.registry import imported

__all__ = ["READERS", "Reader", "read_interface", "read_point_sds"]

_TABLE = "strandline.readers.tables:read_text"
_MESH = "strandline.readers.by_meshio:read_by_meshio"
_VTK = "strandline.readers.vtk_xml:read_vtk_xml"
_XDMF = "strandline.readers.xdmf:read_xdmf"
_BY_VTK = "strandline.readers.by_vtk:read_by_vtk"
_JSON = "strandline.readers.json_outlines:read_json"

READERS: dict[str, str] = {
    ".csv": _TABLE,
    ".tsv": _TABLE,
    ".txt": _TABLE,
    ".dat": _TABLE,
    ".npy": "strandline.readers.tables:read_npy",
    ".vtu": _VTK,
    ".vtp": _VTK,
    ".pvtu": _VTK,
    ".pvtp": _VTK,
    ".pvd": "strandline.readers.series:read_pvd",
    ".xdmf": _XDMF,
    ".xmf": _XDMF,
    ".stl": _MESH,
    ".ply": _MESH,
    ".msh": "strandline.readers.freefem:read_msh",
    ".mesh": _MESH,
    ".vtk": "strandline.readers.by_vtk:read_legacy",
    ".vts": _BY_VTK,
    ".vtr": _BY_VTK,
    ".vtm": "strandline.readers.series:read_vtm",
    ".frd": "strandline.readers.calculix:read_frd",
    ".json": _JSON,
    ".geojson": _JSON,
}
"""Suffixes of files → ``module:name`` of the function that reads them; others are read as text."""
TEXTS: dict[str, str] = {
    r"\*Step *=.*\n\*Time *=.*\n\*Data *=": "strandline.readers.febio:read_febio",
    r"(?s).*displacements \(vx,vy,vz\) for set": "strandline.readers.calculix:read_dat",
    r"MeshVersionFormatted": _MESH,
}
"""Patterns of the first lines of a text file → the same, whatever its suffix."""
ENDED = (".npy", ".json", ".geojson")
"""Suffixes of files of points whose end shows that they are whole."""
Reader = Callable[[Path, Reading, str], Contents]
"""(path, how to read it, its name in messages) → contents of the file."""


def read_interface(
    path: Path, how: Reading, *, name: str = "", ended: bool = False, unused: Callable[[str], None] | None = None
) -> Interface:
    """Return the interface in the file at `path`, in mm.

    Args:
        path: Path of the file.
        how: How to read the file.
        name: Name of the file in messages.
        ended: Whether a text table without a `count` must end with a line break, as programs write it.
        unused: Receives the name of point data that look like displacements and are not used.

    Raises:
        Unreadable: the file is missing, cut off, garbage, not finite, or holds no recognisable interface.
        InvalidInput: an optional package is missing.
    """
    name = name or path.name
    _require_file(path, name)
    require_known(path, how, name)
    if ended and how.count is None and how.is_table and how.suffix not in ENDED:
        require_end(path, name)
    contents = _contents(path, how, name)
    key = unused_displacement(contents, how)
    if unused is not None and key is not None:
        unused(key)
    try:
        return interface_of(contents, how, name)
    except Unreadable:
        raise
    except InvalidInput as error:
        raise Unreadable(
            f"{name}: {error.what}",
            value=error.value,
            expected=error.expected,
            remedy=error.remedy,
            kind="invalid_interface",
        ) from None


def read_point_sds(path: Path, how: Reading, *, name: str = "") -> Float[np.ndarray, " point"]:
    """Return the standard deviations of the points of the interface in a table, in mm.

    Args:
        path: Path of the file.
        how: How to read the file; its `sd` names the column.
        name: Name of the file in messages.

    Raises:
        Unreadable: The file is damaged, or a standard deviation is not above 0.
    """
    name = name or path.name
    return point_sds(_contents(path, how, name), how, name)


def _contents(path: Path, how: Reading, name: str) -> Contents:
    """Return the contents of the file; any error of its reader on a damaged file becomes `Unreadable`."""
    target = _reader(path, how)
    reader: Reader = imported(target, f"reader of {name}")
    if target == _TABLE and (how.time is not None or how.plane != "xy"):
        raise refused(f"{name} is a table of one time", "`time` or `plane`", "`columns` alone", "Remove it.")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            contents = reader(path, how, name)
        _require_contents(contents, target)
        _require_whole(contents)
    except InvalidInput:
        raise
    except (Exception, SystemExit) as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise refused(
            f"{name} cannot be read", reason, f"a whole {how.suffix} file", "Look at the file, or at what writes it."
        ) from None
    return contents


def _reader(path: Path, how: Reading) -> str:
    """Return ``module:name`` of the function that reads the file, by its suffix or else its first lines."""
    if how.reader is not None:
        return how.reader
    target = READERS.get(how.suffix, _TABLE)
    if target != _TABLE:
        return target
    with path.open("rb") as file:
        begin = file.read(1000).decode("utf-8-sig", "replace").lstrip()
    return next((found for pattern, found in TEXTS.items() if re.match(pattern, begin)), target)


def _require_file(path: Path, name: str) -> None:
    """Refuse what is not a file; a pipe would never end."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise missing(path, name) from None
    except OSError as error:
        raise refused(f"{name} cannot be read", str(error), "a readable file") from None
    if not stat.S_ISREG(mode):
        raise refused(f"{name} cannot be read", f"{path} is not a file", "a readable text file")


def _require_contents(found: object, target: str) -> None:
    """Refuse anything but contents from a reader of the user's own."""
    if isinstance(found, Contents) and isinstance(found.points, np.ndarray):
        return
    what = f"a {type(found).__name__}" if not isinstance(found, Contents) else "points that are not a NumPy array"
    raise InvalidInput(
        f"what the reader {target} returns",
        value=what,
        expected="strandline.readers.Contents, its points a NumPy array (point, xyz)",
        remedy="Correct the reader.",
    )


def _require_whole(contents: Contents) -> None:
    """Refuse data that do not belong to the points and cells."""
    number = len(contents.points)
    for block in contents.blocks:
        if block.nodes.min() < 0 or block.nodes.max() >= number:
            raise ValueError("cells with points that do not exist")
        if any(len(values) != len(block.nodes) for values in block.data.values()):
            raise ValueError("cell data without one row per cell")
    if any(len(values) != number for values in contents.data.values()):
        raise ValueError("point data without one row per point")
    if contents.points.ndim != 2 or not np.issubdtype(contents.points.dtype, np.floating):
        raise ValueError("points that are not a table of numbers")
