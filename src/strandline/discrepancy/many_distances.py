"""Sums of closest distances between points and polylines that move a little from run to run, without the distances.

The runs of a batch hardly differ, so only a few segments can be closest to a point in any of them. Bounds on how far
points and segments move within a block of similar runs show which. These are compared for all runs of the block
together, compiled and in double precision. The closest segment is never left out: the sums equal those of trying all
segments, except for rounding.
"""

from collections.abc import Iterator
from functools import lru_cache, partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from strandline.foundations import WIDEST, double, side_by_side

_LOOKED_AT = 16  # nodes compared to find out which runs are alike
FEWEST = 16  # number of runs from which compiling pays off
BLOCK = 128  # runs processed together: the data of one loop fit into a core's cache
FEWEST_ROWS = 2048
"""Least length of the arrays of rows of pairs; they are padded to few lengths, so that little is compiled."""
ENOUGH = 64
"""Ratio of pairs compared, in all runs, to pairs bounded, from which it pays to bound again for half the runs."""
ABREAST = 4  # segments compared with a point in one step of the loop
_SLACK = 1e-9  # how much farther than the bound a segment may be, as a share of the extent: far more than rounding
Frames = tuple[Any, ...]  # frames of segments, see `frames`
Rows = tuple[Any, Any, Any, Any]
"""Numbers of segments, shape (row, abreast), and of the point of each row, whether it is the point's last row, and the
number of rows that count."""
Points = Float[np.ndarray, "#run point 2"]
Corners = Float[np.ndarray, "#run corner 2"]
Values = Float[np.ndarray, "..."]  # (point or segment, run), or without the run axis if all runs share it


def similar(points: Float[np.ndarray, "run point xyz"], size: int) -> list[Int[np.ndarray, " some"]]:
    """Return indices of the runs in blocks of at most `size`, ordered along the direction in which they differ most."""
    some = points[:, :: max(1, points.shape[1] // _LOOKED_AT)].reshape(len(points), -1)
    apart = some - some.mean(axis=0)
    _, vectors = np.linalg.eigh(apart.T @ apart)
    order = np.argsort(apart @ vectors[:, -1], kind="stable")
    return np.array_split(order, max(1, -(-len(points) // size)))


def motion(
    points: Float[np.ndarray, "run point xyz"],
) -> tuple[Float[np.ndarray, "point xyz"], Float[np.ndarray, " point"]]:
    """Return the middle of the box that holds each node in all runs, and half its diagonal: no run is farther away."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = 0.5 * (high - low)
    return low + half, np.sqrt(np.einsum("pk,pk->p", half, half))


def signed_sums(
    points: Points,
    corners: Corners,
    cells: Int[np.ndarray, "cell 2"],
    weights: Float[np.ndarray, "#run point"],
    features: Float[np.ndarray, "point feature"] | None = None,
) -> tuple[Float[np.ndarray, " run"], Float[np.ndarray, "run feature"]] | None:
    """Return Σ w r² and Σ f r over the points of each run, r the signed distance to that run's polyline, mm.

    r is positive on the side of the normals (`Interface.normals`). An array with one row is the same in all runs.
    Without f, the first sum is found in less time. Return None for few runs, or if JAX is in single precision.
    """
    runs = max(len(points), len(corners))
    if runs < FEWEST or not double():
        return None
    centre, number = points[0].mean(axis=0), 0 if features is None else features.shape[1]
    squares, products = np.empty(runs), np.empty((runs, number))

    def block(task: tuple[Rows, Int[np.ndarray, " some"]]) -> list[Any]:
        """Return the sums of some runs, padded to a number of runs that is compiled already."""
        pairs, rows = task
        (x, y), ends = (_runs_last(_padded(array, rows) - centre) for array in (points, corners))
        (factors,) = _runs_last(_padded(weights, rows)[..., None])
        return [np.asarray(one) for one in _loop()(x, y, factors, features, *ends, cells, pairs)]

    (order,) = similar(points if len(points) > 1 else corners, runs)
    todo = [*tasks(points, corners, cells, order)]
    for (_, rows), found in zip(todo, side_by_side(block, todo), strict=True):
        squares[rows], products[rows] = found[0][: len(rows)], found[1].T[: len(rows)]
    return squares, products


def tasks(
    points: Points, corners: Corners, cells: Int[np.ndarray, "cell 2"], rows: Int[np.ndarray, " some"]
) -> Iterator[tuple[Rows, Int[np.ndarray, " some"]]]:
    """Yield blocks of runs with their pairs; runs that share few enough pairs share the search for them."""
    some = [array if len(array) == 1 else array[rows] for array in (points, corners)]
    near = _near(some[0], some[1], cells)
    if len(rows) > BLOCK and len(rows) * near.sum() > ENOUGH * near.size:
        for half in np.array_split(rows, 2):
            yield from tasks(points, corners, cells, half)
        return
    pairs = _segment_pairs(near)
    for first in range(0, len(rows), BLOCK):
        yield pairs, rows[first : first + BLOCK]


def _padded(array: Float[np.ndarray, "..."], rows: Int[np.ndarray, " some"]) -> Float[np.ndarray, "..."]:
    """Return these runs, padded with the last one to one of a few lengths; all of the array if all runs share it."""
    length = BLOCK // 4 if len(rows) <= BLOCK // 4 else BLOCK
    return array if len(array) == 1 else np.asarray(array[np.pad(rows, (0, length - len(rows)), mode="edge")])


def _runs_last(values: Float[np.ndarray, "#run point column"]) -> list[Values]:
    """Return the columns with the runs on the last axis; without that axis if all runs share them."""
    if len(values) == 1:
        return list(values[0].T)
    return [np.ascontiguousarray(column.T) for column in np.moveaxis(values, -1, 0)]


def _segment_pairs(near: Bool[np.ndarray, "point cell"]) -> Rows:
    """Return the segments to compare with each point, those that `near` marks, at least one for each. `ABREAST`
    segments are in a row, some repeated to fill it; the rows of one point are consecutive. The arrays are padded to one
    of a few lengths.
    """
    point, cell = np.nonzero(near)
    counts = np.bincount(point, minlength=len(near))
    rows = -(-counts // ABREAST)
    owner, total = np.repeat(np.arange(len(near)), rows), int(rows.sum())
    place = ABREAST * (np.arange(total) - (np.cumsum(rows) - rows)[owner])
    within = np.minimum(place[:, None] + np.arange(ABREAST), (counts - 1)[owner, None])
    segments = cell[(np.cumsum(counts) - counts)[owner, None] + within]
    last = np.append(owner[1:] != owner[:-1], True)
    room = FEWEST_ROWS
    while room < total:
        room *= 8
    filled = np.zeros((room, ABREAST), np.int32), np.zeros(room, np.int32), np.zeros(room, bool)
    for array, values in zip(filled, (segments, owner, last), strict=True):
        array[:total] = values
    return *filled, total


def _near(points: Points, corners: Corners, cells: Int[np.ndarray, "cell 2"]) -> Bool[np.ndarray, "point cell"]:
    """Return which segments may be closest to which points in some run of the block. A segment moves at most as far as
    its corners do. It may be the closest one if its least possible distance does not exceed the largest possible
    distance of any other one.
    """
    middles, moved = motion(points)
    bends, bent = motion(corners)
    least, most = _bounds()(*middles.T, *bends.T, cells, bent[cells].max(axis=1))
    slack = _SLACK * max(float(np.abs(middles).max()), float(np.abs(bends).max()))
    beyond = np.asarray(least) > (np.asarray(most) + 2 * moved + slack)[:, None]
    return np.asarray(~beyond)


def frames(x: Any, y: Any, cells: Any) -> Frames:
    """Return the unit tangent u of each segment, its middle m as m·u and m×u, and half its length."""
    import jax.numpy as jnp

    i, j = cells[:, 0], cells[:, 1]
    dx, dy = x[j] - x[i], y[j] - y[i]
    mx, my = 0.5 * (x[i] + x[j]), 0.5 * (y[i] + y[j])
    length = jnp.sqrt(dx * dx + dy * dy)
    whole = jnp.where(length > 0, length, 1.0)
    ux, uy = dx / whole + (length == 0), dy / whole
    return ux, uy, mx * ux + my * uy, mx * uy - my * ux, 0.5 * length


def _apart(x: Any, y: Any, segment: Any) -> tuple[Any, Any]:
    """Return the squared distance of points to segments given by their frames, and that to the left of their lines."""
    import jax.numpy as jnp

    ux, uy, along, across, half = segment
    beyond = jnp.maximum(jnp.abs(x * ux + y * uy - along) - half, 0.0)
    off = y * ux - x * uy + across
    return beyond * beyond + off * off, off


@lru_cache(maxsize=1)
def _bounds() -> Any:
    """Return the compiled function for the least distance to each segment, and the largest to the closest one."""
    import jax
    import jax.numpy as jnp

    @partial(jax.jit, compiler_options=WIDEST)
    def bounds(x: Any, y: Any, across: Any, up: Any, cells: Any, bent: Any) -> Any:
        distance = jnp.sqrt(_apart(x[:, None], y[:, None], frames(across, up, cells))[0])
        return distance - bent, (distance + bent).min(axis=1)

    return bounds


@lru_cache(maxsize=1)
def _loop() -> Any:
    """Return the compiled loop over the rows of pairs. Runs are on the last axis. An array that all runs share lacks
    this axis: numbers instead of vectors of length one make the loop ten times as fast.
    """
    import jax
    import jax.numpy as jnp

    @partial(jax.jit, compiler_options=WIDEST)
    def loop(x: Any, y: Any, weights: Any, features: Any, across: Any, up: Any, cells: Any, rows: Rows) -> Any:
        """Return Σ w r², shape (run,), and Σ f r, (feature, run)."""
        polyline, (segments, owners, last, number) = frames(across, up, cells), rows
        runs = (x[0] + across[0]).size

        def row(i: Any, state: Any) -> Any:
            """Compare a point with one row of segments; after its last row, keep its squared distance with a sign."""
            best, side, found = state
            p = owners[i]
            for k in range(ABREAST):
                square, off = _apart(x[p], y[p], [frame[segments[i, k]] for frame in polyline])
                side = jnp.where(square < best, off, side)
                best = jnp.minimum(best, square)
            if features is None:
                found = found + jnp.where(last[i], weights[p] * best, 0.0)
            else:
                found = jax.lax.dynamic_update_slice(found, jnp.copysign(best, side)[None], (p, jnp.zeros_like(p)))
            return jnp.where(last[i], jnp.inf, best), side, found

        begin = jnp.full(runs, jnp.inf), jnp.zeros(runs), jnp.zeros(runs if features is None else (len(x), runs))
        found = jax.lax.fori_loop(0, number, row, begin)[2]
        if features is None:
            return found, jnp.zeros((0, runs))
        squares = jnp.abs(found)
        total = (weights[None] @ squares)[0] if weights.ndim == 1 else (weights * squares).sum(axis=0)
        return total, features.T @ jnp.copysign(jnp.sqrt(squares), found)

    return loop
