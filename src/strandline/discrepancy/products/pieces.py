"""Polylines of many runs cut into short straight pieces, and the pairs of pieces that come close in some run."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

__all__ = ["Division", "Pairs", "Pieces", "lengths"]


def lengths(
    points: Float[np.ndarray, "point 2 *run"], cells: Int[np.ndarray, "cell 2"]
) -> Float[np.ndarray, "cell *run"]:
    """Return the lengths of the segments."""
    steps = points[cells[:, 1]] - points[cells[:, 0]]
    return np.asarray(np.hypot(steps[:, 0], steps[:, 1]))


@dataclass(frozen=True, eq=False)
class Pieces:
    """Straight pieces of the polylines of some runs: middles, and halves of the vectors from start to end."""

    middles: Float[np.ndarray, "piece 2 *run"]
    halves: Float[np.ndarray, "piece 2 *run"]

    def boxes(self) -> tuple[Float[np.ndarray, "piece 2"], Float[np.ndarray, "piece 2"]]:
        """Return the corners of the boxes that hold each piece in all runs."""
        low, high = self.middles - abs(self.halves), self.middles + abs(self.halves)
        return (low, high) if low.ndim == 2 else (low.min(axis=2), high.max(axis=2))


@dataclass(frozen=True, eq=False)
class Division:
    """How segments are divided into equal pieces.

    Args:
        corners: Numbers of the two points of each piece's segment.
        begin: Where the piece begins, as a share of its segment.
        share: Length of the piece, as a share of its segment.
        longest: Length of the longest piece.
    """

    corners: Int[np.ndarray, "piece 2"]
    begin: Float[np.ndarray, " piece"]
    share: Float[np.ndarray, " piece"]
    longest: float

    @classmethod
    def of(cls, cells: Int[np.ndarray, "cell 2"], most: Float[np.ndarray, " cell"], panel: float) -> "Division":
        """Divide segments with lengths of at most `most` into pieces no longer than `panel`."""
        parts = np.maximum(np.ceil(most / panel).astype(int), 1)
        share = 1 / np.repeat(parts, parts)
        rank = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
        return cls(np.repeat(cells, parts, axis=0), rank * share, share, float((most / parts).max()))

    def pieces(self, points: Float[np.ndarray, "point 2 *run"]) -> Pieces:
        """Return the pieces of polylines with these points."""
        column = (-1, *[1] * (points.ndim - 1))
        begin, half = self.begin.reshape(column), 0.5 * self.share.reshape(column)
        start = points[self.corners[:, 0]]
        step = points[self.corners[:, 1]] - start
        return Pieces(start + (begin + half) * step, half * step)


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs of a piece `row` of one side and a piece `column` of the other; each counts `times`."""

    row: Int[np.ndarray, " pair"]
    column: Int[np.ndarray, " pair"]
    times: Float[np.ndarray, " pair"]

    @classmethod
    def near(cls, a: Pieces, b: Pieces, reach: float) -> "Pairs":
        """Return the pairs whose boxes come within `reach` of each other; for a side with itself, each pair once."""
        (low_a, high_a), (low_b, high_b) = a.boxes(), b.boxes()
        gap = np.maximum(np.maximum(low_a[:, None] - high_b, low_b - high_a[:, None]), 0.0)
        row, column = np.nonzero(np.hypot(gap[..., 0], gap[..., 1]) <= reach)
        if a is not b:
            return cls(row, column, np.ones(len(row)))
        once = row <= column
        row, column = row[once], column[once]
        return cls(row, column, np.where(row < column, 2.0, 1.0))
