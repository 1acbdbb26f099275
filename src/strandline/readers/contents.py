"""What a file holds, whatever its format: points, cells in blocks, and data on both."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int, Shaped

__all__ = ["Block", "Contents"]


@dataclass(frozen=True, eq=False)
class Block:
    """Cells of one kind, by meshio's names (``line``, ``triangle6``, …).

    Args:
        kind: of the cells.
        nodes: their numbers.
        data: by name, one row a cell.
    """

    kind: str
    nodes: Int[np.ndarray, "cell node"]
    data: Mapping[str, Shaped[np.ndarray, "..."]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Contents:
    """Points in the file's unit; without blocks they are a polyline in their order.

    Args:
        points: as the file has them.
        blocks: of cells.
        data: by name, one row a point.
        displacement: what is to be added to the points, where the reader knows.
    """

    points: Float[np.ndarray, "point xyz"]
    blocks: tuple[Block, ...] = ()
    data: Mapping[str, Shaped[np.ndarray, "..."]] = field(default_factory=dict)
    displacement: Float[np.ndarray, "point xyz"] | None = None
