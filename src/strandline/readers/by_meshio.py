"""Files that meshio reads: STL, PLY, legacy VTK, meshes of gmsh and Medit; and those of FreeFEM."""

import contextlib
import importlib
import io
from pathlib import Path
from typing import Any

import numpy as np

from strandline.errors import InvalidInput
from strandline.readers.contents import Block, Contents
from strandline.readers.options import Reading

__all__ = ["converted", "imported", "read_by_meshio", "read_msh"]

MODULES = {".stl": "stl", ".ply": "ply", ".vtk": "vtk", ".msh": "gmsh", ".mesh": "medit"}
READS_AT_END = 100
"""Attempts to read past the end after which a PLY file counts as cut off; its reader would go on forever."""


def read_by_meshio(path: Path, how: Reading, name: str) -> Contents:
    """Return the contents of a file with a single time."""
    meshio = imported(name)
    if how.suffix == ".stl":
        _require_end(path.read_bytes())
    with contextlib.redirect_stdout(io.StringIO()):
        source = _Whole(path.read_bytes()) if how.suffix == ".ply" else str(path)
        return converted(getattr(meshio, MODULES[how.suffix]).read(source))


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


def _require_end(content: bytes) -> None:
    """Refuse an STL file in ASCII that is cut off; meshio would read the rest of it."""
    if content.startswith(b"solid") and b"facet" in content[:1000] and b"endsolid" not in content[-1000:]:
        raise EOFError("the file is cut off")


class _Whole(io.BytesIO):
    """The bytes of a file; too many reads past the end raise an error."""

    def __init__(self, content: bytes) -> None:
        super().__init__(content)
        self.at_end = 0

    def readline(self, size: int | None = -1, /) -> bytes:
        """Return the next line."""
        return self._counted(super().readline(-1 if size is None else size))

    def read(self, size: int | None = -1, /) -> bytes:
        """Return the next bytes."""
        return self._counted(super().read(size))

    def _counted(self, found: bytes) -> bytes:
        self.at_end = 0 if found else self.at_end + 1
        if self.at_end > READS_AT_END:
            raise EOFError("the file is cut off")
        return found


def imported(name: str) -> Any:
    """Return meshio.

    Raises:
        InvalidInput: it is not installed.
    """
    try:
        return importlib.import_module("meshio")
    except ModuleNotFoundError:
        raise InvalidInput(
            f"{name} needs meshio",
            value="no package of this name",
            expected="the extra `vtu`",
            remedy="Install it: pip install 'strandline[vtu]'",
        ) from None


def converted(mesh: Any) -> Contents:
    """Return a meshio mesh as contents."""
    blocks = tuple(
        Block(
            block.type,
            np.asarray(block.data, dtype=np.int64),
            {name: np.asarray(arrays[k]) for name, arrays in mesh.cell_data.items()},
        )
        for k, block in enumerate(mesh.cells)
        if block.type != "vertex" and len(block.data)
    )
    return Contents(
        np.asarray(mesh.points, dtype=float), blocks, {name: np.asarray(v) for name, v in mesh.point_data.items()}
    )
