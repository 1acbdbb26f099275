"""Meshes of FreeFEM in its own format: ``savemesh(Th, "mesh.msh")`` in two dimensions.

The first line counts vertices, triangles and edges; then come x, y and label of each vertex, and the vertices, from 1,
and the label of each triangle and edge (FreeFEM's documentation, chapter on meshes).
"""

from pathlib import Path

import numpy as np

from strandline.readers.by_meshio import read_by_meshio
from strandline.readers.contents import Block, Contents
from strandline.readers.options import Reading

__all__ = ["read_msh"]


def read_msh(path: Path, how: Reading, name: str) -> Contents:
    """Return a mesh of FreeFEM, or of gmsh, which uses the same suffix.

    Raises:
        ValueError: The file is cut off, or neither of the two.
    """
    content = path.read_bytes()
    if content.lstrip().startswith(b"$"):
        return read_by_meshio(path, how, name)
    words = content.split()
    counts = [int(word) for word in words[:3]]
    widths = (3, 4, 3)
    ends = 3 + np.cumsum([count * width for count, width in zip(counts, widths, strict=True)])
    if len(words) != ends[-1]:
        raise ValueError(f"{len(words)} numbers, of {ends[-1]} for {counts} vertices, triangles and edges")
    parts = np.split(np.array(words, dtype=float), [3, *ends[:-1]])[1:]
    vertices, triangles, edges = (part.reshape(-1, width) for part, width in zip(parts, widths, strict=True))
    blocks = [
        Block(kind, rows[:, :-1].astype(np.int64) - 1, {"label": rows[:, -1].astype(np.int64)})
        for kind, rows in (("triangle", triangles), ("line", edges))
        if len(rows)
    ]
    return Contents(vertices[:, :2], tuple(blocks), {"label": vertices[:, 2].astype(np.int64)})
