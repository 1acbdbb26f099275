"""Which segments of a polyline may be the closest ones: all are tried, compiled and in single precision.

The sieve lets through a few segments for each point. The closest one is always among them, because an error bound for
single precision is added to the distances. The exact formula then decides which of them is the closest.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache, partial, reduce
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from strandline.discrepancy.memo import Snapshot
from strandline.numerics.compiled import WIDEST, ample
from strandline.numerics.threads import side_by_side

__all__ = ["GROUP", "near_groups"]

GROUP = 8
"""Consecutive segments that are let through or held back together."""
_POINTS = 1024
"""Points in one compiled call."""
_SLACK = 1e-5
"""Bound on the errors of two distances, 30 · 2⁻²⁴ each, relative to the polyline's plus the point's extent."""
_FARTHEST = 100.0
"""Distance of a point from the polyline's middle, in its extents, from which single precision is useless."""


def near_groups(
    points: Float[np.ndarray, "point 2"], snapshot: Snapshot
) -> Iterator[tuple[Int[np.ndarray, " pair"], Int[np.ndarray, " pair"]]]:
    """Yield pairs of a point and a group of segments `GROUP * k` … `GROUP * k + GROUP - 1`, points in ascending order.

    A point's groups contain its closest segment, or all segments that share the least distance. Points very far away
    are left out.
    """
    polyline = _polyline(snapshot)
    scaled = (points - polyline.middle) / polyline.extent
    size = np.abs(scaled).max(axis=1)
    useful = np.flatnonzero(size <= _FARTHEST)
    parts = (useful[k : k + _POINTS] for k in range(0, len(useful), _POINTS))
    return side_by_side(partial(_sift, polyline, scaled, _SLACK * (1 + size)), parts)


@dataclass(frozen=True, eq=False)
class _Polyline:
    """Segments in their own frames, lengths relative to the extent: (constant, segment of the group, group).

    The constants are the unit tangent u (2), the middle m as m·u and m×u, and half the length.
    """

    middle: Float[np.ndarray, " 2"]
    extent: float
    segments: Float[np.ndarray, "5 segment group"]


@lru_cache(maxsize=8)
def _polyline(snapshot: Snapshot) -> _Polyline:
    target = snapshot.interface
    middle = 0.5 * (target.points.min(axis=0) + target.points.max(axis=0))
    extent = float(np.abs(target.points - middle).max())
    start, end = np.moveaxis(((target.points - middle) / extent)[target.cells], (1, 2), (0, 1))
    lengths, centres = np.hypot(*(end - start)), 0.5 * (start + end)
    tangents = (end - start) / np.where(lengths > 0, lengths, 1.0)
    tangents[0] += lengths == 0  # a segment too short to differ from a point may have any direction
    along, across = (centres * tangents).sum(axis=0), _cross(centres, tangents)
    constants = np.stack([*tangents, along, across, 0.5 * lengths])
    number = len(target.cells)
    groups = ample(-(-number // GROUP))
    padded = np.pad(constants, ((0, 0), (0, groups * GROUP - number)), mode="edge").reshape(5, groups, GROUP)
    return _Polyline(middle, extent, np.ascontiguousarray(padded.transpose(0, 2, 1), dtype=np.float32))


def _sift(
    polyline: _Polyline,
    scaled: Float[np.ndarray, "point 2"],
    slack: Float[np.ndarray, " point"],
    rows: Int[np.ndarray, " some"],
) -> tuple[Int[np.ndarray, " pair"], Int[np.ndarray, " pair"]]:
    some = np.pad(scaled[rows], ((0, _POINTS - len(rows)), (0, 0)), mode="edge")
    squares = np.asarray(_least_squares()(some.T.astype(np.float32), polyline.segments))[:, : len(rows)]
    bounds = (np.sqrt(squares.min(axis=0).astype(float)) + slack[rows]) ** 2
    group, row = np.divmod(np.flatnonzero(squares <= bounds.astype(np.float32)), len(rows))
    order = np.argsort(row, kind="stable")
    return rows[row[order]], group[order]


@lru_cache(maxsize=1)
def _least_squares() -> Callable[..., Any]:
    """Return the compiled squared distance of points (2, point) to the closest segment of each group."""
    import jax
    import jax.numpy as jnp

    def square(p: jax.Array, segment: jax.Array) -> Any:
        *tangent, along, across, half = segment[..., None]
        beyond = jnp.maximum(jnp.abs(p[0] * tangent[0] + p[1] * tangent[1] - along) - half, 0.0)
        off = _cross(p, tangent) - across
        return beyond * beyond + off * off

    @partial(jax.jit, compiler_options=WIDEST)
    def least_squares(p: jax.Array, segments: jax.Array) -> Any:
        return reduce(jnp.minimum, (square(p, segments[:, j]) for j in range(GROUP)))

    return least_squares


def _cross(p: Any, u: Any) -> Any:
    return p[0] * u[1] - p[1] * u[0]
