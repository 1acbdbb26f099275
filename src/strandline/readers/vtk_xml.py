"""VTU, VTP and their parallel forms: points, cells and data, read without VTK."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Int, Shaped

from strandline.readers.contents import Block, Contents
from strandline.readers.options import Reading
from strandline.readers.vtk_arrays import Encoding, numbers, split

__all__ = ["POLYGON", "POLYLINE", "STRIP", "beside", "blocks_of", "joined", "read_vtk_xml", "require_each_once"]

KINDS = {
    3: "line",
    5: "triangle",
    8: "pixel",
    9: "quad",
    10: "tetra",
    11: "voxel",
    12: "hexahedron",
    13: "wedge",
    14: "pyramid",
    21: "line3",
    22: "triangle6",
    23: "quad8",
    24: "tetra10",
    25: "hexahedron20",
    28: "quad9",
}
"""VTK's numbers of cell types → their names."""
OF_ORDER = {(68, 2): "line", (68, 3): "line3", (69, 3): "triangle", (69, 6): "triangle6", (70, 4): "quad"}
OF_ORDER |= {(70, 9): "quad9", (71, 4): "tetra", (71, 10): "tetra10"}
"""Lagrange cells by VTK's number and number of nodes."""
POLYLINE, STRIP, POLYGON = 4, 6, 7
POINT_LIKE = (0, 1, 2)


def read_vtk_xml(path: Path, how: Reading, name: str) -> Contents:
    """Return the contents of a VTU, VTP, PVTU or PVTP file, its pieces joined.

    Raises:
        ValueError: (also KeyError, IndexError, SyntaxError) a damaged file, or one of another kind.
    """
    return _read(path, parallel=True)


def _read(path: Path, *, parallel: bool) -> Contents:
    """Return the contents of a file; one that lists other files is read only if `parallel`."""
    root, encoding = split(path.read_bytes())
    form = root.get("type", "")
    (data,) = [child for child in root if child.tag == form] or [root]
    pieces = data.findall("Piece")
    if parallel and form in ("PUnstructuredGrid", "PPolyData"):
        files = [piece.attrib["Source"] for piece in pieces]
        require_each_once(files)
        parts = [_read(beside(path, file), parallel=False) for file in files]
    elif form in ("UnstructuredGrid", "PolyData"):
        parts = [_piece(piece, encoding, poly=form == "PolyData") for piece in pieces]
    else:
        raise ValueError(f"data of the type {form or root.tag}; expected UnstructuredGrid or PolyData")
    parts = [part for part in parts if len(part.points)]
    if not parts:
        raise ValueError("it holds no points")
    return joined(parts)


def beside(path: Path, source: str) -> Path:
    """Return the file that `path` names, which must lie in the same folder or below."""
    target = path.parent / source
    if not target.resolve().is_relative_to(path.parent.resolve()):
        raise ValueError(f"it refers to {source}, outside of its folder")
    return target


def require_each_once(files: Sequence[str]) -> None:
    """Refuse a list that names a file more than once, which costs memory and adds nothing."""
    again = next((file for file in files if files.count(file) > 1), None) if len(set(files)) < len(files) else None
    if again is not None:
        raise ValueError(f"it names {again} more than once")


def joined(parts: Sequence[Contents]) -> Contents:
    """Return several pieces as one, with coincident points merged; data that some pieces lack are left out."""
    if len(parts) == 1:
        return parts[0]
    shifts = np.cumsum([0, *(len(part.points) for part in parts)])
    points, first, number = np.unique(
        np.concatenate([part.points for part in parts]), axis=0, return_index=True, return_inverse=True
    )
    blocks = tuple(
        Block(block.kind, number.reshape(-1)[block.nodes + shift], block.data)
        for part, shift in zip(parts, shifts.tolist(), strict=False)
        for block in part.blocks
    )
    shared = set.intersection(*(set(part.data) for part in parts))
    data = {name: np.concatenate([part.data[name] for part in parts])[first] for name in sorted(shared)}
    return Contents(points, blocks, data)


def _piece(piece: ElementTree.Element, encoding: Encoding, *, poly: bool) -> Contents:
    points = _arrays(piece.find("Points"), encoding)
    if not points:
        return Contents(np.empty((0, 3)))
    (coordinates,) = points.values()
    if coordinates.shape != (int(piece.attrib["NumberOfPoints"]), 3):
        raise ValueError(f"{piece.attrib['NumberOfPoints']} points announced, the shape {coordinates.shape} found")
    cells = _poly_cells(piece, encoding) if poly else _grid_cells(piece, encoding)
    data = _arrays(piece.find("CellData"), encoding)
    visible = data.pop("vtkGhostType", None)
    blocks = blocks_of(list(cells), data, None if visible is None else visible == 0)
    for block in blocks:
        if block.nodes.min() < 0 or block.nodes.max() >= len(coordinates):
            raise ValueError("cells with points that do not exist")
    return Contents(coordinates.astype(float), blocks, _arrays(piece.find("PointData"), encoding))


def _arrays(parent: ElementTree.Element | None, encoding: Encoding) -> dict[str, Shaped[np.ndarray, "..."]]:
    """Return the arrays of numbers below `parent` by name."""
    found = [] if parent is None else parent.findall("DataArray")
    return {
        array.get("Name", f"#{k}"): numbers(array, encoding)
        for k, array in enumerate(found)
        if array.attrib["type"] != "String"
    }


def _grid_cells(piece: ElementTree.Element, encoding: Encoding) -> Iterator[tuple[int, Any]]:
    """Yield VTK's number and the nodes of each cell."""
    cells = _arrays(piece.find("Cells"), encoding)
    if cells:
        yield from zip(cells["types"].tolist(), _sliced(cells), strict=True)


def _poly_cells(piece: ElementTree.Element, encoding: Encoding) -> Iterator[tuple[int, Any]]:
    """Yield the cells of a VTP file in the order of its cell data."""
    for tag, kind in (("Verts", 2), ("Lines", POLYLINE), ("Polys", POLYGON), ("Strips", STRIP)):
        cells = _arrays(piece.find(tag), encoding)
        if cells and len(cells["offsets"]):
            yield from ((kind, nodes) for nodes in _sliced(cells))


def _sliced(cells: dict[str, Shaped[np.ndarray, "..."]]) -> list[Int[np.ndarray, " node"]]:
    ends = cells["offsets"].astype(np.int64)
    connectivity = cells["connectivity"].astype(np.int64)
    if len(ends) and (ends[-1] != len(connectivity) or (np.diff(ends, prepend=0) < 0).any()):
        raise ValueError("cells cut off")
    return np.split(connectivity, ends[:-1]) if len(ends) else []


def blocks_of(
    cells: Sequence[tuple[int, Any]],
    data: dict[str, Shaped[np.ndarray, "..."]],
    visible: Shaped[np.ndarray, "..."] | None = None,
) -> tuple[Block, ...]:
    """Return the cells by kind; polylines become lines, polygons with more than three corners fans of triangles."""
    nodes: dict[str, list[Any]] = {}
    owners: dict[str, list[int]] = {}
    for number, (kind, corners) in enumerate(cells):
        if kind in POINT_LIKE or (visible is not None and not visible[number]):
            continue
        name, parts = _parts(kind, corners)
        nodes.setdefault(name, []).extend(parts)
        owners.setdefault(name, []).extend([number] * len(parts))
    return tuple(
        Block(name, np.array(nodes[name], dtype=np.int64), {key: value[owners[name]] for key, value in data.items()})
        for name in nodes
        if nodes[name]
    )


def _parts(kind: int, nodes: Any) -> tuple[str, list[Any]]:
    """Return the kind and the nodes of the cells that one cell becomes."""
    if kind == POLYLINE:
        return "line", [nodes[k : k + 2] for k in range(len(nodes) - 1)]
    if kind == POLYGON:
        return "triangle", [nodes[[0, k, k + 1]] for k in range(1, len(nodes) - 1)]
    if kind == STRIP:  # every second triangle runs the other way
        return "triangle", [nodes[[k + k % 2, k + 1 - k % 2, k + 2]] for k in range(len(nodes) - 2)]
    name = KINDS.get(kind) or OF_ORDER.get((kind, len(nodes)))
    if name is None:
        raise ValueError(f"a cell of VTK's type {kind} with {len(nodes)} nodes, which is not read")
    return name, [nodes[[0, 2, 1, 3, 5, 4]] if name == "wedge" else nodes]  # VTK's base faces outwards
