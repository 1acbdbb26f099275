"""The contents of a file, whatever its format: points, cells in blocks, and data on both."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int, Shaped

__all__ = ["Block", "Contents"]


@dataclass(frozen=True, eq=False)
class Block:
    """Cells of one kind, by meshio's names (``line``, ``triangle6``, …).

    Args:
        kind: Kind of the cells.
        nodes: Node numbers of each cell.
        data: Arrays by name, one row per cell.
    """

    kind: str
    nodes: Int[np.ndarray, "cell node"]
    data: Mapping[str, Shaped[np.ndarray, "..."]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Contents:
    """Points in the file's unit; without blocks they are a polyline in their order.

    Args:
        points: Points (point, xyz) as in the file.
        blocks: Blocks of cells.
        data: Arrays by name, one row per point.
        displacement: Displacement to add to the points, if the reader knows it.
        pieces: Number of the piece that each point belongs to, if the points are not one polyline.
    """

    points: Float[np.ndarray, "point xyz"]
    blocks: tuple[Block, ...] = ()
    data: Mapping[str, Shaped[np.ndarray, "..."]] = field(default_factory=dict)
    displacement: Float[np.ndarray, "point xyz"] | None = None
    pieces: Int[np.ndarray, " point"] | None = None
