"""Conversion of blocks of numbers to an interface and back."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.errors import ForwardModelError, InvalidInput
from strandline.interface import Interface

__all__ = ["UNITS", "Layout", "flattened"]

UNITS = {"mm": 1.0, "um": 1e-3, "µm": 1e-3, "m": 1e3}
"""Millimetres in each unit of length."""
SHAPES = ("points", "columns")


@dataclass(frozen=True)
class Layout:
    """Where a model's output holds the coordinates of an interface.

    Args:
        shape: ``points``: block 0 holds x0, y0, x1, y1, …; ``columns``: block 0 holds the x's, block 1 the y's.
        dim: Number of coordinates: 2 for a polyline through the points in their order, 3 for a surface; its triangles,
            three node numbers from 0 each, are the block after the coordinates.
        closed: Whether a polyline returns to its first point.

    Raises:
        InvalidInput: any other value.
    """

    shape: str = "points"
    dim: int = 2
    closed: bool = False

    def __post_init__(self) -> None:
        for name, value, right in (
            ("shape", self.shape, self.shape in SHAPES),
            ("dim", self.dim, type(self.dim) is int and self.dim in (2, 3)),
            ("closed", self.closed, type(self.closed) is bool and not (self.closed and self.dim == 3)),
        ):
            if not right:
                raise _wrong_option(name, value)

    @classmethod
    def from_options(cls, options: object) -> "Layout":
        """Return the layout of ``{shape: points, dim: 2, closed: false}``, each key optional."""
        given = {} if options is None else options
        if not isinstance(given, Mapping) or not set(given) <= {"shape", "dim", "closed"}:
            raise _wrong_option("", options)
        return cls(**given)

    @property
    def coordinate_blocks(self) -> int:
        """Number of output blocks that hold coordinates; a surface's triangles are in the next one."""
        return 1 if self.shape == "points" else self.dim

    def points(self, blocks: Sequence[Float[np.ndarray, " number"]]) -> Float[np.ndarray, "point xyz"]:
        """Return the coordinates, or their derivatives, that `coordinate_blocks` blocks hold.

        Raises:
            ForwardModelError: ``protocol``: the blocks do not hold `dim` coordinates for each point.
        """
        if len(blocks) < self.coordinate_blocks:
            raise _unfit(blocks, f"at least {self.coordinate_blocks} blocks")
        if self.shape == "points":
            if blocks[0].size % self.dim:
                raise _unfit(blocks, f"{self.dim} numbers for each point in block 0")
            return np.ascontiguousarray(blocks[0].reshape(-1, self.dim))
        columns = blocks[: self.dim]
        if len({column.size for column in columns}) > 1:
            raise _unfit(blocks, f"as many numbers in each of the first {self.dim} blocks")
        return np.stack(list(columns), axis=1)

    def interface(self, blocks: Sequence[Float[np.ndarray, " number"]], factor: float) -> Interface:
        """Return the interface; `factor` is mm per unit of the coordinates.

        Raises:
            ForwardModelError: ``protocol``: as for `points`, or a surface without triangles.
            InvalidInterface: points that form no interface.
        """
        points = factor * self.points(blocks)
        if self.dim == 2:
            return Interface.polyline(points, closed=self.closed)
        if len(blocks) <= self.coordinate_blocks:
            raise _unfit(blocks, "a block with the triangles after the coordinates")
        corners = blocks[self.coordinate_blocks]
        if corners.size % 3 or (corners != np.round(corners)).any():
            raise _unfit(blocks, "three whole numbers for each triangle")
        return Interface(points, corners.reshape(-1, 3).astype(np.int64))


def flattened(interface: Interface) -> list[list[float]]:
    """Return the blocks of `interface` in the layout ``points``, mm: coordinates, then a surface's triangles."""
    blocks = [interface.points.ravel().tolist()]
    return blocks if interface.dim == 2 else [*blocks, interface.cells.astype(float).ravel().tolist()]


def _wrong_option(name: str, value: object) -> InvalidInput:
    return InvalidInput(
        f"interface.{name}".rstrip("."),
        value=value,
        expected="{shape: points or columns, dim: 2 or 3, closed: true or false (polylines only)}",
        remedy="Correct the option.",
    )


def _unfit(blocks: Sequence[Any], expected: str) -> ForwardModelError:
    sizes = [len(block) for block in blocks]
    return ForwardModelError("protocol", f"the model's output has blocks of {sizes} numbers; expected {expected}")
