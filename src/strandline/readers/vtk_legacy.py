"""Legacy VTK: polygonal data, in ASCII or binary, as pyvista saves them; meshio reads the grids."""

from io import BufferedReader
from pathlib import Path
from typing import Any

import numpy as np

from strandline.readers.by_meshio import read_by_meshio
from strandline.readers.contents import Contents
from strandline.readers.options import Reading
from strandline.readers.vtk_xml import POLYGON, POLYLINE, STRIP, blocks_of

__all__ = ["read_legacy"]

CELLS = {"VERTICES": 2, "LINES": POLYLINE, "POLYGONS": POLYGON, "TRIANGLE_STRIPS": STRIP}
TYPES = {"float": "f4", "double": "f8", "unsigned_char": "u1", "int": "i4", "vtkidtype": "i4", "vtktypeint64": "i8"}


def read_legacy(path: Path, how: Reading, name: str) -> Contents:
    """Return the contents of a legacy file; a damaged one raises ValueError, KeyError or IndexError."""
    with path.open("rb") as file:
        version, _, form, dataset = (file.readline().upper().split() for _ in range(4))
        if dataset == [b"DATASET", b"POLYDATA"]:
            return _polygons(file, form == [b"ASCII"], by_offsets=float(version[-1]) >= 5)
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
