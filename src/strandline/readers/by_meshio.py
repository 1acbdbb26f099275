"""What meshio reads: STL, PLY, legacy VTK and Gmsh files."""

import contextlib
import importlib
import io
from pathlib import Path
from typing import Any

import numpy as np

from strandline.errors import InvalidInput
from strandline.readers.contents import Block, Contents
from strandline.readers.options import Reading

__all__ = ["converted", "imported", "read_by_meshio"]

MODULES = {".stl": "stl", ".ply": "ply", ".vtk": "vtk", ".msh": "gmsh"}


def read_by_meshio(path: Path, how: Reading, name: str) -> Contents:
    """Return what a file of one time holds."""
    meshio = imported(name)
    with contextlib.redirect_stdout(io.StringIO()):
        return converted(getattr(meshio, MODULES[how.suffix]).read(str(path)))


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
    """Return a mesh of meshio as contents."""
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
