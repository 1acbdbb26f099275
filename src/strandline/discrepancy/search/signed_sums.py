"""Sums of the signed distances from points to polylines that move a little from run to run, without the distances.

A quadratic form of the residuals r of each run, such as rᵀ C⁻¹ r with C diagonal plus a few columns, needs only Σ w r²
and a few sums Σ f r over the points. They are added up in the compiled loop that finds the closest segments.
"""

from functools import lru_cache, partial
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from strandline.discrepancy.search.blocks import similar
from strandline.discrepancy.search.many_distances import ABREAST, FEWEST, Frames, frames, padded, tasks
from strandline.numerics.compiled import WIDEST
from strandline.numerics.threads import double, side_by_side

__all__ = ["signed_sums"]


def signed_sums(
    points: Float[np.ndarray, "point 2"],
    corners: Float[np.ndarray, "run corner 2"],
    cells: Int[np.ndarray, "cell 2"],
    weights: Float[np.ndarray, " point"],
    features: Float[np.ndarray, "point feature"],
) -> tuple[Float[np.ndarray, " run"], Float[np.ndarray, "run feature"]] | None:
    """Return Σ w r² and Σ f r over the points, r the signed distance to the polyline of each run, mm.

    r is positive on the side of the normals (`Interface.normals`). Returns None for few runs, or with JAX in single
    precision.

    Args:
        points: Points, the same in all runs, mm.
        corners: Corners of the polylines, mm.
        cells: Numbers of the two corners of each segment.
        weights: Weights w.
        features: Factors f.
    """
    runs = len(corners)
    if runs < FEWEST or not double():
        return None
    centre = points.mean(axis=0)
    shared = points - centre
    both = np.column_stack([weights, features])

    def block(task: tuple[Any, Int[np.ndarray, " some"]]) -> Float[np.ndarray, "some sum"]:
        """Return the sums of some runs, padded to a number of runs that is compiled already."""
        pairs, rows = task
        some = corners[padded(rows)] - centre
        x, y = (np.ascontiguousarray(some[..., axis].T) for axis in (0, 1))
        arguments = pairs.segments, pairs.points, pairs.last, pairs.number
        return np.asarray(_loop()(shared[:, 0], shared[:, 1], both, x, y, cells, *arguments)).T[: len(rows)]

    (order,) = similar(corners, runs)
    todo = [*tasks(points[None], corners, cells, order)]
    out = np.empty((runs, both.shape[1]))
    for (_, rows), sums in zip(todo, side_by_side(block, todo), strict=True):
        out[rows] = sums
    return out[:, 0], out[:, 1:]


@lru_cache(maxsize=1)
def _loop() -> Any:
    """Return the compiled loop over the rows of pairs, runs on the last axis."""
    import jax
    import jax.numpy as jnp

    @partial(jax.jit, compiler_options=WIDEST)
    def loop(
        x: Any,
        y: Any,
        factors: Any,
        across: Any,
        up: Any,
        cells: Any,
        segments: Any,
        owners: Any,
        last: Any,
        number: Any,
    ) -> Any:
        """Return the sums, shape (sum, run)."""
        polyline: Frames = frames(across, up, cells)
        runs = across.shape[1]

        def row(i: Any, state: Any) -> Any:
            """Compare a point with one row of segments; its last row leaves its squared distance, with a sign."""
            best, side, signed = state
            p = owners[i]
            for k in range(ABREAST):
                ux, uy, along, off_line, half = (frame[segments[i, k]] for frame in polyline)
                beyond = jnp.maximum(jnp.abs(x[p] * ux + y[p] * uy - along) - half, 0.0)
                off = y[p] * ux - x[p] * uy + off_line
                square = beyond * beyond + off * off
                side = jnp.where(square < best, off, side)
                best = jnp.minimum(best, square)
            signed = jax.lax.dynamic_update_slice(signed, jnp.copysign(best, side)[None], (p, jnp.zeros_like(p)))
            return jnp.where(last[i], jnp.inf, best), side, signed

        begin = jnp.full(runs, jnp.inf), jnp.zeros(runs), jnp.zeros((len(x), runs))
        signed = jax.lax.fori_loop(0, number, row, begin)[2]
        squares = jnp.abs(signed)
        distances = jnp.copysign(jnp.sqrt(squares), signed)
        return jnp.concatenate([factors[:, :1].T @ squares, factors[:, 1:].T @ distances])

    return loop
