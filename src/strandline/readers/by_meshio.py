"""Files that meshio reads: STL, PLY, legacy VTK, meshes of gmsh and Medit; and those of FreeFEM."""

import contextlib
import io
import re
import tempfile
from importlib import import_module
from io import BufferedReader
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from strandline.foundations import of_extra
from strandline.readers.cells import dimension
from strandline.readers.contents import Block, Contents, refused
from strandline.readers.options import Reading
from strandline.readers.vtk_xml import POLYGON, POLYLINE, STRIP, Allowance, beside, blocks_of, chosen_time

MODULES = {".stl": "stl", ".ply": "ply", ".vtk": "vtk", ".msh": "gmsh"}
MEDIT = re.compile(rb"(Dimension|Vertices|Edges|Triangles|Quadrilaterals|Tetrahedra|Prisms|Pyramids|Hexah?edra)\b")
"""Sections of a Medit file that are read."""
READS_AT_END = 100
"""Attempts to read past the end after which a PLY file counts as cut off; its reader would go on forever."""
CELLS = {"VERTICES": 2, "LINES": POLYLINE, "POLYGONS": POLYGON, "TRIANGLE_STRIPS": STRIP}
TYPES = {"float": "f4", "double": "f8", "unsigned_char": "u1", "int": "i4", "vtkidtype": "i4", "vtktypeint64": "i8"}


def read_by_meshio(path: Path, how: Reading, name: str) -> Contents:
    """Return the contents of a file with a single time."""
    meshio = of_extra("meshio", "vtu", name)
    content = path.read_bytes()
    ascii_stl = how.suffix == ".stl" and content.startswith(b"solid") and b"facet" in content[:1000]
    if ascii_stl and b"endsolid" not in content[-1000:]:
        raise EOFError("the file is cut off")  # meshio would read the rest of it
    with contextlib.redirect_stdout(io.StringIO()):
        source = _WholeFile(content) if how.suffix == ".ply" else str(path)
        return converted(getattr(meshio, MODULES[how.suffix]).read(source))


def read_medit(path: Path, how: Reading, name: str) -> Contents:
    """Return a mesh of Medit in double precision, without what FreeFEM and bamg add, at which meshio stops."""
    meshio, content = of_extra("meshio", "vtu", name), path.read_bytes()
    if not content.rstrip().endswith(b"End"):
        raise EOFError("the file is cut off")
    sections = re.split(rb"(?m)^\s*(?=[A-Za-z])", content)
    with tempfile.NamedTemporaryFile(suffix=".mesh") as copy:  # a name that ends with "b" is binary to meshio
        copy.write(b"\n".join([b"MeshVersionFormatted 2", *(one for one in sections if MEDIT.match(one)), b""]))
        copy.flush()
        return converted(meshio.medit.read(copy.name))


def read_msh(path: Path, how: Reading, name: str) -> Contents:
    """Return a mesh of gmsh, or of FreeFEM, which uses the same suffix for plane meshes.

    FreeFEM's first line counts vertices, triangles and edges; then come x, y and label of each vertex, and the
    vertices, from 1, and the label of each triangle and edge (FreeFEM's documentation, chapter on meshes).
    """
    content = path.read_bytes()
    if content.lstrip().startswith(b"$"):
        return read_by_meshio(path, how, name)
    numbers = np.array(content.split(), dtype=float)
    sizes = np.array([3, 4, 3]) * numbers[:3].astype(int)
    if len(numbers) != 3 + sizes.sum():
        raise ValueError(f"{len(numbers)} numbers instead of {3 + sizes.sum()}")
    vertices, triangles, edges = np.split(numbers[3:], np.cumsum(sizes)[:2])
    cells = {"triangle": triangles.reshape(-1, 4).astype(np.int64), "line": edges.reshape(-1, 3).astype(np.int64)}
    blocks = [Block(kind, rows[:, :-1] - 1, {"label": rows[:, -1]}) for kind, rows in cells.items() if len(rows)]
    places = vertices.reshape(-1, 3)
    return Contents(places[:, :2], tuple(blocks), {"label": places[:, 2]})


class _WholeFile(io.BytesIO):
    """The bytes of a file; too many reads past the end raise an error."""

    at_end = 0

    def readline(self, size: int | None = -1, /) -> bytes:
        return self._counted(super().readline(size))

    def read(self, size: int | None = -1, /) -> bytes:
        return self._counted(super().read(size))

    def _counted(self, found: bytes) -> bytes:
        self.at_end = 0 if found else self.at_end + 1
        if self.at_end > READS_AT_END:
            raise EOFError("the file is cut off")
        return found


def converted(mesh: Any) -> Contents:
    """Return a meshio mesh as contents; gmsh's physical names become cell data, 1 in the region of that name."""
    blocks = []
    for k, block in enumerate(mesh.cells):
        data = {name: np.asarray(arrays[k]) for name, arrays in mesh.cell_data.items()}
        if "gmsh:physical" in data:
            for region, (tag, dim) in mesh.field_data.items():
                data.setdefault(region, (data["gmsh:physical"] == tag) & (dim == dimension(block.type)))
        if block.type != "vertex" and len(block.data):
            blocks.append(Block(block.type, np.asarray(block.data, dtype=np.int64), data))
    data = {name: np.asarray(values) for name, values in mesh.point_data.items()}
    return Contents(np.asarray(mesh.points, dtype=float), tuple(blocks), data)


def read_legacy(path: Path, how: Reading, name: str) -> Contents:
    """Return the contents of a legacy file; a damaged one raises ValueError, KeyError or IndexError."""
    with path.open("rb") as file:
        version, _, form, dataset = (file.readline().upper().split() for _ in range(4))
        if dataset == [b"DATASET", b"POLYDATA"]:
            return _polygons(file, form == [b"ASCII"], by_offsets=float(version[-1]) >= 5)
    if form == [b"BINARY"] and re.search(rb"\nLOOKUP_TABLE +\S+ +\d+ *\n", path.read_bytes()):
        what = f"{name} is a legacy VTK file, BINARY, with a table of colours, as FreeFEM writes it"
        remedy = "In FreeFEM, give savevtk a name that ends with .vtu, or `bin=false`."
        raise refused(what, "LOOKUP_TABLE", "a .vtu file, or legacy VTK as text", remedy)
    return read_by_meshio(path, how, name)


def _polygons(file: BufferedReader, text: bool, *, by_offsets: bool) -> Contents:
    """Return points, cells and data; from version 5 on, cells are given by offsets as in VTP files."""
    points: Any = None
    cells: list[tuple[int, Any]] = []
    data: dict[str, dict[str, Any]] = {"POINT_DATA": {}, "CELL_DATA": {}}
    owner: dict[str, Any] = {}
    rows = 0
    while line := _line(file):
        match line.decode().split():
            case ["POINTS", count, kind]:
                points = _numbers(file, text, kind, int(count), 3)
            case [key, count, size] if key in CELLS and by_offsets:
                kinds = ((n, file.readline().split()[1].decode()) for n in (count, size))
                ends, nodes = (_numbers(file, text, kind, int(n))[:, 0] for n, kind in kinds)
                cells += [(CELLS[key], cell) for cell in np.split(nodes, ends[1:-1])]
            case [key, count, size] if key in CELLS:
                rest = _numbers(file, text, "int", int(size))[:, 0]
                for _ in range(int(count)):
                    cells.append((CELLS[key], rest[1 : 1 + rest[0]]))
                    rest = rest[1 + rest[0] :]
            case [key, count] if key in data:
                owner, rows = data[key], int(count)
            case ["VECTORS" | "NORMALS", name, kind]:
                owner[name] = _numbers(file, text, kind, rows, 3)
            case ["SCALARS", name, kind, *width]:
                file.readline()  # the name of its table of colours
                owner[name] = _numbers(file, text, kind, rows, int(width[0]) if width else 1)
            case ["TEXTURE_COORDINATES", name, width, kind]:
                owner[name] = _numbers(file, text, kind, rows, int(width))
            case [name, width, count, kind]:  # an array of a FIELD
                owner[name] = _numbers(file, text, kind, int(count), int(width))
            case ["METADATA"]:
                while file.readline().strip():
                    pass
            case [key, *_] if key != "FIELD":
                raise ValueError(f"{key}, which is not read; save it as .vtp")
    return Contents(points.astype(float), blocks_of(cells, data["CELL_DATA"]), data["POINT_DATA"])


def _numbers(file: BufferedReader, text: bool, kind: str, rows: int, width: int = 1) -> Any:
    """Return the next numbers, which are big-endian in a binary file."""
    dtype = np.dtype(TYPES[kind.lower()]).newbyteorder(">")
    if not text:
        found = np.frombuffer(file.read(rows * width * dtype.itemsize), dtype).reshape(rows, width)
        file.read(file.peek(1)[:1] == b"\n")
        return found
    words: list[bytes] = []
    while len(words) < rows * width and (line := _line(file)):
        words += line.split()
    return np.array(words, dtype).reshape(rows, width)


def _line(file: BufferedReader) -> bytes:
    line = file.readline()
    if line and not line.endswith(b"\n"):
        raise EOFError("the file is cut off")
    return line


def read_xdmf(path: Path, how: Reading, name: str) -> Contents:
    """Return the contents of an XDMF file, or of one of its times; each function may have a series of its own."""
    meshio = of_extra("meshio", "vtu", name)
    root = ElementTree.fromstring(path.read_bytes())
    _require_own_data(path, root)
    if not any("CollectionType" in grid.attrib for grid in root.iter("Grid")):
        return converted(meshio.xdmf.read(str(path)))
    with meshio.xdmf.TimeSeriesReader(str(path)) as series:
        points, cells = series.read_points_cells()
        point_data: dict[str, Any] = {}
        cell_data: dict[str, Any] = {}
        for grid in (grid for grid in series.domain if grid.get("GridType") == "Collection"):
            series.collection = list(grid)
            times = [float(step.find("Time").attrib["Value"]) for step in series.collection]
            _, of_points, of_cells = series.read_data(chosen_time(times, how, name))
            point_data |= of_points
            cell_data |= of_cells
    return converted(meshio.Mesh(points, cells, point_data=point_data, cell_data=cell_data))


def _require_own_data(path: Path, root: ElementTree.Element) -> None:
    """Refuse data outside the folder of the file, and data that unpack to far more than the files that hold them."""
    allowances: dict[Path, Allowance] = {}
    for item in root.iter("DataItem"):
        form, text = item.get("Format", ""), (item.text or "").strip()
        if form == "Binary":
            raise ValueError(f"its data in {text} are of the format Binary, which is not read; write HDF or XML")
        if form == "HDF":
            source, _, place = text.partition(":")
            file = beside(path, source)
            allowance = allowances.setdefault(file, Allowance(file.stat().st_size))
            _require_dataset(file, place, allowance)


def _require_dataset(file: Path, place: str, allowance: Allowance) -> None:
    """Refuse anything but a plain array of numbers within the file itself."""
    h5py: Any = import_module("h5py")
    with h5py.File(file, "r") as found:
        inner: Any = found
        for key in place.strip("/").split("/"):
            if not isinstance(inner.get(key, getlink=True), h5py.HardLink):
                raise ValueError(f"{file.name} refers to data elsewhere at {place}")
            inner = inner[key]
        if not isinstance(inner, h5py.Dataset) or inner.dtype.kind not in "iuf":
            raise ValueError(f"{file.name} holds no numbers at {place}")
        if inner.external or inner.is_virtual:
            raise ValueError(f"{file.name} refers to data in other files at {place}")
        allowance.take(inner.size * inner.dtype.itemsize)
