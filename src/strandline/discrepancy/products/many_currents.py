"""The currents measure on a batch of polylines: every segment in short pieces, one kernel value for two of them.

For pieces no longer than `LONGEST_PIECE` kernel widths the midpoint rule is exact to some 1e-3 of the noise that it is
compared with, since the kernel is a Gaussian; only kinks count. Neighbours in a batch hardly differ, so that most pairs
of pieces are too far apart in all of them and are left out together. Kernel values are single precision, their sums
double: 1e-6 of ⟨T,T⟩.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int

from strandline.numerics.threads import threads

__all__ = ["currents_of_many"]

LONGEST_PIECE = 1.5
"""Length of a piece of a segment, in kernel widths, for the integral; with the centre rule a segment is one piece."""
REACH = 4.5
"""Kernel widths beyond which a pair counts for nothing, e^-10 of a pair at one place."""
BLOCK = 256
"""Interfaces worked on together."""
CHUNK = 128
"""Pairs of pieces worked on together: with their block they fit into a core's cache."""


_Rows = Int[np.ndarray, " _"]
_Values = Float[np.ndarray, " _"]


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Midpoints and steps of the pieces of a block of polylines; runs on the last axis."""

    middles: Float32[np.ndarray, "piece 2 run"]
    steps: Float32[np.ndarray, "piece 2 run"]

    @classmethod
    def of(cls, points: Float32[np.ndarray, "point 2 run"], cells: Int[np.ndarray, "cell 2"], parts: int) -> "_Pieces":
        start = points[cells[:, 0]]
        step = (points[cells[:, 1]] - start) / parts
        shares = np.arange(parts, dtype=np.float32)[:, None, None] + np.float32(0.5)
        middles = start[:, None] + step[:, None] * shares
        return cls(middles.reshape(-1, *points.shape[1:]), np.repeat(step, parts, axis=0))


def currents_of_many(
    points: Float[np.ndarray, "run point 2"],
    cells: Int[np.ndarray, "cell 2"],
    observed: Float[np.ndarray, "other 2"],
    observed_cells: Int[np.ndarray, "other_cell 2"],
    *,
    width: float,
    refined: bool,
) -> Float[np.ndarray, " run"]:
    """Return d² = ⟨S,S⟩ - 2⟨S,T⟩ + ⟨T,T⟩ of each polyline S, mm²; never negative.

    Args:
        points: Points of the simulated polylines (run, point, 2), mm.
        cells: Segments of the simulated polylines, two point numbers each.
        observed: Points of the observed polyline T, mm.
        observed_cells: Segments of the observed polyline.
        width: Kernel width σ_W, mm.
        refined: Whether to integrate along the segments, or to take one point per segment.
    """
    parts = (_parts(points[:1], cells, width), _parts(observed[None], observed_cells, width)) if refined else (1, 1)
    middle = observed.mean(axis=0)
    target = _Pieces.of((observed - middle)[:, :, None].astype(np.float32), observed_cells, parts[1])
    square = float(_product(target, target, width)[0])
    order = np.argsort(points.mean(axis=1) @ np.ones(2), kind="stable")
    points = (points - middle).astype(np.float32)

    def block(rows: _Rows) -> _Values:
        pieces = _Pieces.of(np.ascontiguousarray(np.moveaxis(points[rows], 0, 2)), cells, parts[0])
        return np.asarray(_product(pieces, pieces, width) - 2 * _product(pieces, target, width) + square)

    values = np.empty(len(points))
    rows = [order[k : k + BLOCK] for k in range(0, len(order), BLOCK)]
    for some, found in zip(rows, _side_by_side(block, rows), strict=True):
        values[some] = found
    return np.maximum(values, 0.0)


def _side_by_side(task: Callable[[_Rows], _Values], parts: Sequence[_Rows]) -> Iterator[_Values]:
    workers = min(threads(), len(parts))
    if workers < 2:
        yield from map(task, parts)
        return
    with ThreadPoolExecutor(workers) as pool:
        yield from pool.map(task, parts)


def _parts(points: Float[np.ndarray, "run point 2"], cells: Int[np.ndarray, "cell 2"], width: float) -> int:
    steps = points[:, cells[:, 1]] - points[:, cells[:, 0]]
    return max(1, math.ceil(float(np.hypot(steps[..., 0], steps[..., 1]).max()) / (LONGEST_PIECE * width)))


def _product(a: _Pieces, b: _Pieces, width: float) -> Float[np.ndarray, " run"]:
    """Return ⟨a,b⟩ of each polyline of `a` with its partner in `b`, or with the only one."""
    row, column = _near(a.middles, b.middles, REACH * width)
    times = np.ones(len(row), np.float32)
    if a is b:
        keep = row <= column
        row, column = row[keep], column[keep]
        times = np.where(row < column, np.float32(2), np.float32(1))
    out, factor = np.zeros(a.middles.shape[2]), np.float32(-0.5 / width**2)
    for k in range(0, len(row), CHUNK):
        i, j = row[k : k + CHUNK], column[k : k + CHUNK]
        x, y = a.middles[i, 0] - b.middles[j, 0], a.middles[i, 1] - b.middles[j, 1]
        x *= x
        y *= y
        x += y
        x *= factor
        np.exp(x, out=x)
        y = a.steps[i, 0] * b.steps[j, 0]
        y += a.steps[i, 1] * b.steps[j, 1]
        y *= x
        out += times[k : k + CHUNK] @ y
    return out


def _near(
    a: Float32[np.ndarray, "piece 2 run"], b: Float32[np.ndarray, "other 2 run2"], reach: float
) -> tuple[Int[np.ndarray, " pair"], Int[np.ndarray, " pair"]]:
    """Return the pairs whose midpoints come within `reach` in some run, perhaps a few more."""
    gap = np.maximum(a.min(axis=2)[:, None] - b.max(axis=2), b.min(axis=2) - a.max(axis=2)[:, None])
    np.maximum(gap, 0.0, out=gap)
    row, column = np.nonzero(np.einsum("abk,abk->ab", gap, gap) <= reach**2)
    return row, column
