"""Files of formats that are known and not read: pictures, projects, tables of other kinds."""

import re
from pathlib import Path

from strandline.readers.options import Reading
from strandline.readers.problems import refused

__all__ = ["require_known"]

OF_PICTURE = "Its pixels, y down, belong to a picture: give it as `path` in `observation: {image: {path: …}}`."
PICTURE = "To find the interface in it, write `observation: {image: {file: …}}`; see the guide on pictures."
STACK = "To find the surface in it, save it as .tif or .h5 and write `observation: {stack: {file: …}}`."
CURVE = "Save points along the curve as .csv, in order and in the unit of the study."
MESH = "Mesh it, and save the mesh as .vtu, .stl or .msh."
TABLE = "Save the sheet as .csv."

BEGINNINGS = {
    rb"\x89PNG\r\n\x1a\n": ("a picture: a PNG image", PICTURE),
    rb"\xff\xd8\xff": ("a picture: a JPEG image", PICTURE),
    rb"II[*+]\0|MM\0[*+]": ("a picture: a TIFF image", PICTURE),
    rb"GIF8[79]a": ("a picture: a GIF image", PICTURE),
    rb"Iout": ("a selection of ImageJ", OF_PICTURE),
    rb"\s*\{.{0,400}\"shapes\"": ("an annotation of labelme", OF_PICTURE),
    rb"PK\x03\x04": ("an archive or a workbook", "Save what is in it as .csv or .npy."),
    rb"\x89HDF": ("HDF5", "A picture goes with `observation: {image: {dataset: …}}`; save a mesh as .vtu or .xdmf."),
    rb"ISO-10303-21": ("STEP", MESH),
    rb"(<\?xml.{0,200}?)?\s*<svg": ("SVG", CURVE),
    rb"\s*0\s+SECTION|AutoCAD Binary DXF": ("DXF", CURVE),
    rb"NRRD000": ("NRRD", STACK),
    rb".{344}n[i+]1\0": ("NIfTI", STACK),
    rb".{128}DICM": ("DICOM", STACK),
    rb"\*{3}[^\n]*\n\*\*\* Digital Image Correlation Engine": (
        "a solution of DICe",
        "It is a grid of subsets in pixels, y down, and no edge: write the points of the edge as .csv, y up.",
    ),
}
"""Pattern of the first bytes of a file → its format, and the way out."""
SUFFIXES = {
    "_cp_outlines.txt": ("a list of outlines by Cellpose", OF_PICTURE),
    ".gz": ("a packed file", "Unpack it."),
    ".mhd": ("MetaImage", STACK),
    ".mha": ("MetaImage", STACK),
    ".igs": ("IGES", MESH),
    ".iges": ("IGES", MESH),
    ".xls": ("an Excel workbook", TABLE),
    ".inp": ("a deck of Abaqus or CalculiX", "It holds no results: read the .frd or .dat, or a table by `post`."),
    ".odb": ("an output database of Abaqus", "Write a table in `post`; see the guide on your own simulator."),
    ".xplt": ("a plot file of FEBio", "Let FEBio write a logfile with x;y;z of the nodes along the interface."),
    ".foam": ("a case of OpenFOAM", "Sample the patch with `surfaces`, in the format raw or vtk."),
    ".mat": ("MATLAB's workspace", "Save the points with `writematrix(points, 'points.csv')`."),
}
"""End of the file's name → the same, for formats that do not begin alike."""
WITHOUT_COLUMNS = {
    rb"# \S+ +(POINT|FACE)_DATA \d+": (
        "a raw surface of OpenFOAM",
        "Give `columns: [x, y]`, and `sort: x` since its points are not in order along the patch.",
    ),
    rb"index,shape-type,vertex-index,": ("a shapes layer of napari", OF_PICTURE),
}
"""As `BEGINNINGS`, of tables that are read if the study names their columns."""


def require_known(path: Path, how: Reading, name: str) -> None:
    """Refuse a file whose format is known and not read, whatever its suffix; never with a reader of the user's own.

    Args:
        path: The file, which exists.
        how: How to read it.
        name: Name of the file in messages.

    Raises:
        Unreadable: There is no reader for it; the message names the format and the way out.
    """
    if how.reader is not None:
        return
    try:
        with path.open("rb") as file:
            begin = file.read(600)
    except OSError:
        return  # the reader reports why
    patterns = BEGINNINGS | (WITHOUT_COLUMNS if how.columns is None else {})
    by_content = (found for pattern, found in patterns.items() if re.match(pattern, begin, re.DOTALL))
    by_name = (found for end, found in SUFFIXES.items() if how.file.lower().endswith(end))
    form, remedy = next(by_content, None) or next(by_name, ("", ""))
    if form:
        form, _, kind = form.partition(": ")
        expected = "the points of an interface: a table in order, a mesh or a surface"
        raise refused(f"{name} is {form}", kind or path.suffix or "no suffix", expected, remedy)
