"""A file → the interface in it."""

import re
import stat
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float

from strandline.foundations import InvalidInput, imported, unfit
from strandline.interface import Interface
from strandline.readers.contents import Contents, Unreadable, refused, undamaged
from strandline.readers.options import OF_COLUMNS, READERS, TEXT, Reading
from strandline.readers.shape import interface_of, point_sds
from strandline.readers.tables import require_end

FEBIO, DAT = "strandline.readers.calculix:read_febio", "strandline.readers.calculix:read_dat"
TEXTS = {r"\*Step *=.*\n\*Time *=.*\n\*Data *=": FEBIO, r"(?s).*displacements \(vx,vy,vz\) for set": DAT}
"""Patterns of the first lines of a text file → the same, whatever its suffix."""
PLANE = "Remove it. `plane: xz` takes x and z instead of x and y, `plane: yz` y and z"
UNFIT: dict[str, tuple[str, set[str], str, str]] = {
    TEXT: ("a table of one time", {"time", "plane"}, "`columns` alone", "Remove it."),
    FEBIO: ("a logfile of FEBio", OF_COLUMNS, "the places x;y;z of nodes, as they are", f"{PLANE}."),
    DAT: ("displacements that CalculiX prints", OF_COLUMNS, "U of a node set", f"{PLANE}; U is added to the places."),
}
"""Reader of a text → what the text is, the options that say nothing about it, what it holds, and the way out."""
OF_PICTURE = "Its pixels, y down, belong to a picture: give it as `path` in `observation: {image: {path: …}}`."
PICTURE = "To find the interface in it, write `observation: {image: {file: …}}`; see the guide on pictures."
STACK = "To find the surface in it, save it as .tif or .h5 and write `observation: {stack: {file: …}}`."
CURVE = "Save points along the curve as .csv, in order and in the unit of the study."
GRID = "It is a grid of subsets in pixels, y down, and no edge: write the points of the edge as .csv, y up."
PATCH = "Give `columns: [x, y]`, and `sort: x` since its points are not in order along the patch."

BEGINNINGS = {
    rb"\x89PNG\r\n\x1a\n": ("a picture: a PNG image", PICTURE),
    rb"\xff\xd8\xff": ("a picture: a JPEG image", PICTURE),
    rb"II[*+]\0|MM\0[*+]": ("a picture: a TIFF image", PICTURE),
    rb"GIF8[79]a": ("a picture: a GIF image", PICTURE),
    rb"Iout": ("a selection of ImageJ", OF_PICTURE),
    rb"\s*\{.{0,400}\"shapes\"": ("an annotation of labelme", OF_PICTURE),
    rb"PK\x03\x04": ("an archive or a workbook", "Save what is in it as .csv or .npy."),
    rb"\x89HDF": ("HDF5", "A picture goes with `observation: {image: {dataset: …}}`; save a mesh as .vtu or .xdmf."),
    rb'\s*\((0|1) ".*"\)': ("a mesh of ANSYS Fluent", "Export the interface as .stl or .csv, or the mesh as .vtu."),
    rb"ISO-10303-21": ("STEP", "Mesh it, and save the mesh as .vtu, .stl or .msh."),
    rb"(<\?xml.{0,200}?)?\s*<svg": ("SVG", CURVE),
    rb"\s*0\s+SECTION|AutoCAD Binary DXF": ("DXF", CURVE),
    rb"NRRD000": ("NRRD", STACK),
    rb".{344}n[i+]1\0": ("NIfTI", STACK),
    rb".{128}DICM": ("DICOM", STACK),
    rb"\*{3}[^\n]*\n\*\*\* Digital Image Correlation Engine": ("a solution of DICe", GRID),
}
"""Pattern of the first bytes of a file → its format, and the way out."""
ENDS = {
    "_cp_outlines.txt": ("a list of outlines by Cellpose", OF_PICTURE),
    ".inp": ("a deck of Abaqus or CalculiX", "It holds no results: read the .frd or .dat, or a table by `post`."),
    ".odb": ("an output database of Abaqus", "Write a table in `post`; see the guide on your own simulator."),
    ".xplt": ("a plot file of FEBio", "Let FEBio write a logfile with x;y;z of the nodes along the interface."),
    ".vtm": ("a list of blocks by VTK", "Merge its blocks, or read one of its files."),
    ".vts": ("a structured grid by VTK", "Save it as an unstructured grid, .vtu."),
}
"""End of the file's name → the same, for formats that do not begin alike."""
TABLES = {
    rb"# \S+ +(POINT|FACE)_DATA \d+": ("a raw surface of OpenFOAM", PATCH),
    rb"index,shape-type,vertex-index,": ("a shapes layer of napari", OF_PICTURE),
}
"""As `BEGINNINGS`, of tables that are read if the study names their columns."""
Reader = Callable[[Path, Reading, str], Contents]
"""(path, how to read it, its name in messages) → contents of the file."""


def read_interface(path: Path, how: Reading, *, name: str = "", ended: bool = False) -> Interface:
    """Return the interface in the file at `path`, in mm.

    Args:
        path: Path of the file.
        how: How to read the file.
        name: Name of the file in messages.
        ended: Whether a text table without a `count` must end with a line break, as programs write it.

    Raises:
        Unreadable: the file is missing, cut off, garbage, not finite, or holds no recognisable interface.
        InvalidInput: an optional package is missing.
    """
    name = name or path.name
    _require_file(path, name)
    _require_known(_beginning(path), how, name)
    if ended and how.count is None and _reader(path, how) in (TEXT, *TEXTS.values()):
        with undamaged(name, "a readable text file"):
            require_end(path, name)
    contents = _contents(path, how, name)
    try:
        return interface_of(contents, how, name)
    except Unreadable:
        raise
    except InvalidInput as error:
        what = f"{name}: {error.what}"
        raise refused(what, error.value, error.expected, error.remedy, kind="invalid_interface") from None


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
    what, options, expected, remedy = UNFIT.get(target, ("", set(), "", ""))
    if unfitting := [option for option in how.given if option in options]:
        raise refused(f"{name}, {what}, takes no `{unfitting[0]}`", how.given[unfitting[0]], expected, remedy)
    with undamaged(name, f"a whole {how.suffix} file"):
        contents = reader(path, how, name)
        _require_sound(contents, target)
    return contents


def _reader(path: Path, how: Reading) -> str:
    """Return ``module:name`` of the function that reads the file, by its suffix or else its first lines."""
    target = how.reader or READERS.get(how.suffix, TEXT)
    begin = _beginning(path).decode("utf-8-sig", "replace").lstrip() if target == TEXT else ""
    return next((found for pattern, found in TEXTS.items() if re.match(pattern, begin)), target)


def _beginning(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(1000)
    except OSError:
        return b""  # the reader reports why


def _require_file(path: Path, name: str) -> None:
    """Refuse what is not a file; a pipe would never end."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise refused(f"{name} is missing", str(path), "a file with two columns x, y", kind="result_missing") from None
    except OSError as error:
        raise refused(f"{name} cannot be read", str(error), "a readable file") from None
    if not stat.S_ISREG(mode):
        raise refused(f"{name} cannot be read", f"{path} is not a file", "a readable text file")


def _require_known(begin: bytes, how: Reading, name: str) -> None:
    """Refuse a file whose format is known and not read, whatever its suffix; never with a reader of the user's own."""
    patterns = BEGINNINGS | (TABLES if how.columns is None else {})
    known = [found for pattern, found in patterns.items() if re.match(pattern, begin, re.DOTALL)]
    known += [found for end, found in ENDS.items() if how.file.lower().endswith(end)]
    if known and how.reader is None:
        (form, _, kind), remedy = known[0][0].partition(": "), known[0][1]
        expected = "the points of an interface: a table in order, a mesh or a surface"
        raise refused(f"{name} is {form}", kind or how.suffix or "no suffix", expected, remedy)


def _require_sound(contents: object, target: str) -> None:
    """Refuse anything but contents from a reader of the user's own, and data that do not belong to points and cells."""
    if not isinstance(contents, Contents) or not isinstance(contents.points, np.ndarray):
        known = isinstance(contents, Contents)
        what = "points that are not a NumPy array" if known else f"a {type(contents).__name__}"
        expected = "strandline.readers.Contents, its points a NumPy array (point, xyz)"
        raise unfit(f"what the reader {target} returns", what, expected, "Correct the reader.")
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
