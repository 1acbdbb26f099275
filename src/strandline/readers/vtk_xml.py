"""VTU, VTP and their parallel forms: points, cells and data, read without VTK."""

import base64
import itertools
import lzma
import re
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Shaped

from strandline.readers.contents import Block, Contents, refused
from strandline.readers.options import Reading

Array = Shaped[np.ndarray, "..."]
ALWAYS_BYTES = 64 * 10**6
PER_BYTE = 20
"""Meshes and their data shrink by a factor of 2 to 10."""
UNPACKERS: dict[str, Callable[[], Any]] = {
    "vtkZLibDataCompressor": zlib.decompressobj,
    "vtkLZMADataCompressor": partial(lzma.LZMADecompressor, memlimit=4 * ALWAYS_BYTES),
}
"""Names of compressors in VTK's files → functions that make what unpacks their data."""
KINDS = {3: "line", 5: "triangle", 8: "pixel", 9: "quad", 10: "tetra", 11: "voxel", 12: "hexahedron", 13: "wedge"}
KINDS |= {14: "pyramid", 21: "line3", 22: "triangle6", 23: "quad8", 24: "tetra10", 25: "hexahedron20", 28: "quad9"}
"""VTK's numbers of cell types → their names."""
OF_ORDER = {(68, 2): "line", (68, 3): "line3", (69, 3): "triangle", (69, 6): "triangle6", (70, 4): "quad"}
OF_ORDER |= {(70, 9): "quad9", (71, 4): "tetra", (71, 10): "tetra10"}
"""Lagrange cells by VTK's number and number of nodes."""
POLYLINE, STRIP, POLYGON = 4, 6, 7
POINT_LIKE = (0, 1, 2)


class Allowance:
    """Number of bytes that the data of one file, which has `packed` bytes, may still take."""

    def __init__(self, packed: int) -> None:
        self._packed = packed
        self._limit = self._left = ALWAYS_BYTES + PER_BYTE * packed

    def take(self, number: int) -> None:
        """Use up `number` bytes."""
        self._left -= number
        if self._left < 0:
            found = f"more than {self._limit / 1e6:.0f} MB, from {self._packed / 1e6:.2g} MB"
            raise ValueError(f"its data unpack to {found}; write them uncompressed")

    def unpacked(self, unpacker: Any, data: bytes) -> bytes:
        """Return compressed data as `unpacker`, a new object of zlib or lzma, unpacks them."""
        found: bytes = unpacker.decompress(data, self._left + 1)
        self.take(len(found))
        if not unpacker.eof:
            raise ValueError("its compressed data are cut off")
        return found


@dataclass(frozen=True)
class Encoding:
    """How a file writes its binary numbers.

    `order`: order of the bytes, ``<`` or ``>``; `header`: type of the counts before binary data; `unpacker`: function
    that makes what unpacks compressed data, None if they are not; `allowance`: bytes that the data may still take;
    `appended`: all appended data after the underscore; `raw`: whether these are bytes, not base64.
    """

    order: str
    header: np.dtype[Any]
    unpacker: Callable[[], Any] | None
    allowance: Allowance
    appended: bytes
    raw: bool


def _dtype(name: str, order: str) -> np.dtype[Any]:
    if not re.fullmatch(r"U?Int(8|16|32|64)|Float(32|64)", name):
        raise ValueError(f"numbers of the type {name}")
    return np.dtype(f"{order}{np.dtype(name.lower()).str[1:]}")


def split(content: bytes) -> tuple[ElementTree.Element, Encoding]:
    """Return the root of a file and its encoding; appended data are not XML and are taken out first."""
    head, mark, rest = content.partition(b"<AppendedData")
    appended, raw = b"", False
    if mark:
        attributes, _, rest = rest.partition(b">")
        before, _, appended = rest.partition(b"_")
        end = appended.rfind(b"</AppendedData>")
        if before.strip() or end < 0:
            raise ValueError("its appended data are cut off")
        raw = b"raw" in attributes
        head, appended = head + appended[end + len(b"</AppendedData>") :], appended[:end]
    root = ElementTree.fromstring(head)
    compressor, order = root.get("compressor", ""), ">" if root.get("byte_order") == "BigEndian" else "<"
    if compressor and compressor not in UNPACKERS:
        raise ValueError(f"compressed by {compressor}, which is not read; write with zlib or without")
    header = _dtype(root.get("header_type", "UInt32"), order)
    return root, Encoding(order, header, UNPACKERS.get(compressor), Allowance(len(content)), appended, raw)


def numbers(array: ElementTree.Element, encoding: Encoding) -> Array:
    """Return the numbers of a DataArray; (row, component) if it has several components."""
    dtype, form = _dtype(array.attrib["type"], encoding.order), array.get("format", "ascii")
    if form == "ascii":
        flat = np.array((array.text or "").split(), dtype=dtype.newbyteorder("="))
    elif form == "binary":
        flat = np.frombuffer(_decoded((array.text or "").strip().encode(), encoding, raw=False), dtype)
    elif form == "appended":
        start = int(array.attrib["offset"])
        flat = np.frombuffer(_decoded(encoding.appended[start:], encoding, raw=encoding.raw), dtype)
    else:
        raise ValueError(f"data in the format {form}")
    components = int(array.get("NumberOfComponents", "1"))
    native = flat.astype(dtype.newbyteorder("="))
    return native.reshape(-1, components) if components > 1 else native


def _decoded(stream: bytes, encoding: Encoding, *, raw: bool) -> bytes:
    """Return the bytes of one array: counts first, then the data, possibly compressed in blocks."""
    count, size = encoding.header, encoding.header.itemsize

    def part(number: int, *, after: int = 0) -> bytes:
        """Return some bytes behind others that were encoded separately; only these are decoded."""
        rest = stream[after if raw else 4 * -(-after // 3) :]
        found = rest[:number] if raw else base64.b64decode(rest[: 4 * -(-number // 3)], validate=True)[:number]
        if len(found) < number:
            raise ValueError(f"its data end after {len(found)} of {number} bytes")
        return found

    first = int(np.frombuffer(part(size), count)[0])
    if encoding.unpacker is None:
        apart = not raw and b"=" in stream[: 4 * -(-size // 3)]  # the count was encoded separately
        return part(first, after=size) if apart else part(size + first)[size:]
    head = size * (3 + first)
    ends = np.cumsum([0, *np.frombuffer(part(head), count).tolist()[3:]]).tolist()
    packed = part(ends[-1], after=head)
    blocks = (packed[low:high] for low, high in itertools.pairwise(ends))
    return b"".join(encoding.allowance.unpacked(encoding.unpacker(), block) for block in blocks)


def read_vtk_xml(path: Path, how: Reading, name: str, *, parallel: bool = True) -> Contents:
    """Return the contents of a VTU, VTP, PVTU or PVTP file, its pieces joined; one that lists files if `parallel`."""
    root, encoding = split(path.read_bytes())
    form = root.get("type", "")
    (data,) = [child for child in root if child.tag == form] or [root]
    pieces = data.findall("Piece")
    if parallel and form in ("PUnstructuredGrid", "PPolyData"):
        files = [piece.attrib["Source"] for piece in pieces]
        require_each_once(files)
        parts = [read_vtk_xml(beside(path, file), how, name, parallel=False) for file in files]
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
    if len(set(files)) < len(files):
        raise ValueError(f"it names {next(file for file in files if files.count(file) > 1)} more than once")


def joined(parts: Sequence[Contents]) -> Contents:
    """Return several pieces as one, with coincident points merged; data that some pieces lack are left out."""
    if len(parts) == 1:
        return parts[0]
    shifts = np.cumsum([0, *(len(part.points) for part in parts)])
    every = np.concatenate([part.points for part in parts])
    points, first, number = np.unique(every, axis=0, return_index=True, return_inverse=True)
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
    cells = _cells(piece, encoding, poly=poly)
    data = _arrays(piece.find("CellData"), encoding)
    visible = data.pop("vtkGhostType", None)
    blocks = blocks_of(list(cells), data, None if visible is None else visible == 0)
    for block in blocks:
        if block.nodes.min() < 0 or block.nodes.max() >= len(coordinates):
            raise ValueError("cells with points that do not exist")
    return Contents(coordinates.astype(float), blocks, _arrays(piece.find("PointData"), encoding))


def _arrays(parent: ElementTree.Element | None, encoding: Encoding) -> dict[str, Array]:
    found = [] if parent is None else parent.findall("DataArray")
    named = ((array.get("Name", f"#{k}"), array) for k, array in enumerate(found))
    return {name: numbers(array, encoding) for name, array in named if array.attrib["type"] != "String"}


def _cells(piece: ElementTree.Element, encoding: Encoding, *, poly: bool) -> Iterator[tuple[int, Any]]:
    """Yield VTK's number and the nodes of each cell, those of a VTP file in the order of its cell data."""
    kinds = {"Verts": 2, "Lines": POLYLINE, "Polys": POLYGON, "Strips": STRIP} if poly else {"Cells": 0}
    for tag, kind in kinds.items():
        cells = _arrays(piece.find(tag), encoding)
        if cells and (len(cells["offsets"]) or not poly):
            ends, connectivity = (cells[name].astype(np.int64) for name in ("offsets", "connectivity"))
            if len(ends) and (ends[-1] != len(connectivity) or (np.diff(ends, prepend=0) < 0).any()):
                raise ValueError("cells cut off")
            nodes = np.split(connectivity, ends[:-1]) if len(ends) else []
            yield from zip([kind] * len(nodes) if kind else cells["types"].tolist(), nodes, strict=True)


def blocks_of(
    cells: Sequence[tuple[int, Any]], data: dict[str, Array], visible: Array | None = None
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


def read_pvd(path: Path, how: Reading, name: str) -> Contents:
    """Return the joined contents of the files that a PVD file names for one time."""
    sets = ElementTree.fromstring(path.read_bytes()).iter("DataSet")
    found = [(float(item.get("timestep", "0")), item.attrib["file"]) for item in sets]
    times = sorted({time for time, _ in found})
    chosen = times[chosen_time(times, how, name)]
    files = [file for time, file in found if time == chosen]
    require_each_once(files)
    return joined([read_vtk_xml(beside(path, file), how, name) for file in files])


def chosen_time(times: Sequence[float], how: Reading, name: str) -> int:
    """Return the index of the requested time; of the last one if none is requested."""
    if not times:
        raise refused(f"{name} holds no times", None, "one time or more")
    if how.time is None or isinstance(how.time, str):
        return int(np.argmax(times))
    (kind, value) = next(iter(how.time.items()))
    if kind == "index" and value < len(times):
        return int(value)
    nearest = int(np.argmin(np.abs(np.asarray(times) - value)))
    if kind == "value" and abs(times[nearest] - value) <= 1e-6 * max(abs(value), abs(times[-1] - times[0])):
        return nearest
    shown = f"{len(times)} times from {times[0]:g} to {times[-1]:g}"
    raise refused(f"{name} has no time of {kind} {value:g}", shown, "one of its times", "Correct `time`.")
