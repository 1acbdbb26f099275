"""The double sum behind every inner product of currents, for few nodes and for very many.

Σ_i Σ_j exp(-|x_i - y_j|²/2σ²) n_i·m_j. The matrix of all pairs is never stored: few pairs are summed in blocks, many
by a compiled loop over the y of each tile of neighbouring x. If the kernel is short, a tree finds the y a tile needs.
Threads share the batches of tiles. The batches do not depend on the number of threads, and neither does the sum.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache, partial, reduce
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from strandline.foundations import WHOLE, WIDEST, double, exp2_of_minus, side_by_side

BLOCK = 1 << 16  # pairs that NumPy processes at once; this bounds the memory
SMALL = 1 << 20  # number of pairs up to which blocks are faster than finding neighbours and compiling
_UNROLLED = 8  # partners processed in one step of the loop
_CLOSE = 300.0
"""Largest |x|² + |y|², times log₂e/2σ², at which x·y yields |x - y|² to 1e-13 of the kernel, which is not 0 yet."""


@dataclass(frozen=True, eq=False)
class Nodes:
    """Quadrature points of an interface, mm, and its normals there times length or area."""

    points: Float[np.ndarray, "node xyz"]
    normals: Float[np.ndarray, "node xyz"]

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True)
class Sizes:
    """How many nodes the compiled loop takes at once; the sum does not depend on it.

    Up to `small` pairs, blocks are faster than finding neighbours and compiling. If a tree chooses the partners, `tile`
    nodes are in a tile, and at most `tiles` tiles with `gathered` partners together in one compiled call; if all nodes
    are partners, at most `full_tile` nodes, a multiple of 8, are in a tile.
    """

    small: int = SMALL
    tile: int = 128
    full_tile: int = 5120
    tiles: int = 128
    gathered: int = 1 << 19


USUAL = Sizes()


def kernel_sum(a: Nodes, b: Nodes, width: float, *, reach: float, sizes: Sizes = USUAL) -> float:
    """Return Σ_i Σ_j exp(-|x_i - y_j|²/2σ²) n_i·m_j over the nodes (x, n) of `a` and (y, m) of `b`.

    Pairs farther apart than `reach`, mm, may be left out; the kernel has the width σ, mm. JAX sums many pairs if its
    float64 is switched on, else NumPy: slower, with the same result to rounding.
    """
    if len(a) * len(b) <= sizes.small or not double():
        return _blocked(a, b, width)
    return math.fsum(side_by_side(_compiled(_with_blank(a), _with_blank(b), width), _batches(a, b, reach, sizes)))


@dataclass(frozen=True, eq=False)
class _TileBatch:
    """Tiles of one side, and which `partners` on the other side each needs: those from `begin` up to `end`."""

    tiles: Int[np.ndarray, "tile node"]
    partners: Int[np.ndarray, " partner"]
    begin: Int[np.ndarray, " tile"]
    end: Int[np.ndarray, " tile"]
    weights: Float[np.ndarray, " tile"]


def _batches(a: Nodes, b: Nodes, reach: float, sizes: Sizes) -> Iterator[_TileBatch]:
    """Yield every pair within reach once, some that are farther apart, and blank nodes that fill the rows. In a sum of
    nodes with themselves, every pair of different tiles is yielded only once, with weight 2.
    """
    order = cKDTree(a.points).indices
    tiles = _cut(order, sizes.tile, blank=len(a))
    x = a.points[_cut(order, sizes.tile, blank=int(order[-1]))]
    middles = 0.5 * (x.min(axis=1) + x.max(axis=1))
    radii = np.linalg.norm(x - middles[:, None], axis=2).max(axis=1) + reach
    tree = cKDTree(b.points)
    counts = tree.query_ball_point(middles, radii, return_length=True)
    if 2 * counts.sum() > len(tiles) * len(b):
        yield from _everyone(len(a), len(b), sizes.full_tile, itself=a is b)
        return
    rank = np.argsort(order)
    groups = np.stack([np.cumsum(counts) // sizes.gathered, np.arange(len(tiles)) // sizes.tiles])
    for some in np.split(np.arange(len(tiles)), np.flatnonzero(np.diff(groups).any(axis=0)) + 1):
        near = [np.array(row, int) for row in tree.query_ball_point(middles[some], radii[some])]
        weights = np.ones(len(some))
        if a is b:
            later = [row[rank[row] >= (k + 1) * sizes.tile] for k, row in zip(some, near, strict=True)]
            near = [*later, *tiles[some]]
            some, weights = np.tile(some, 2), np.repeat([2.0, 1.0], len(some))
        rows = [_cut(row, _UNROLLED, blank=len(b)).ravel() for row in near]
        partners, end = np.concatenate(rows), np.cumsum([len(row) for row in rows])
        spare = 0, (2 if a is b else 1) * sizes.tiles - len(some)
        yield _TileBatch(
            np.pad(tiles[some], (spare, (0, 0)), constant_values=len(a)),
            _filled_up(partners, blank=len(b)),
            np.pad(np.concatenate([[0], end[:-1]]), spare),
            np.pad(end, spare),
            np.pad(weights, spare),
        )


def _everyone(number: int, others: int, full_tile: int, *, itself: bool) -> Iterator[_TileBatch]:
    """Yield every pair of nodes, in their order, tile by tile."""
    step = full_tile // 8
    size = -(-number // (-(-number // full_tile) * step)) * step
    tiles = _cut(np.arange(number), size, blank=number)
    partners = _cut(np.arange(others), _UNROLLED, blank=others).ravel()
    first = np.arange(len(tiles)) * size
    begin, end, weights = 0 * first, np.full(len(tiles), len(partners)), np.ones(len(tiles))
    if itself:
        behind = np.minimum(first + size, len(partners))
        begin, end = np.concatenate([first, behind]), np.concatenate([behind, end])
        tiles, weights = np.tile(tiles, (2, 1)), np.concatenate([weights, 2 * weights])
    filled = _filled_up(partners, blank=others)
    for k in range(len(tiles)):
        yield _TileBatch(tiles[k : k + 1], filled, begin[k : k + 1], end[k : k + 1], weights[k : k + 1])


def _cut(order: Int[np.ndarray, " node"], size: int, *, blank: int) -> Int[np.ndarray, "tile {size}"]:
    """Return rows of `size`, the last one filled up with `blank`."""
    return np.pad(order, (0, -len(order) % size), constant_values=blank).reshape(-1, size)


def _filled_up(partners: Int[np.ndarray, " partner"], *, blank: int) -> Int[np.ndarray, " filled"]:
    """Return the array padded to a power of two: few lengths to compile for, and the padding costs no time."""
    length = max(1 << max(len(partners) - 1, 0).bit_length(), _UNROLLED)
    return np.pad(partners, (0, length - len(partners)), constant_values=blank)


def _with_blank(nodes: Nodes) -> Nodes:
    """Return the nodes and a blank one after them, at the position of the last one and with normal 0."""
    return Nodes(np.pad(nodes.points, ((0, 1), (0, 0)), mode="edge"), np.pad(nodes.normals, ((0, 1), (0, 0))))


def _blocked(a: Nodes, b: Nodes, width: float) -> float:
    total = 0.0
    size = max(1, BLOCK // max(len(b), 1))
    for k in range(0, len(a), size):
        x, n = a.points[k : k + size], a.normals[k : k + size]
        r2 = reduce(np.add, ((x[:, i, None] - b.points[:, i]) ** 2 for i in range(x.shape[1])))
        total += float(np.sum(n * (np.exp(r2 * (-0.5 / width**2)) @ b.normals)))
    return total


def _compiled(a: Nodes, b: Nodes, width: float) -> Callable[[_TileBatch], float]:
    """Return a function that sums a batch with the compiled loop."""
    middle, scale = 0.5 * (a.points.min(axis=0) + a.points.max(axis=0)), math.sqrt(0.5 / math.log(2)) / width
    x, y = ((one.points - middle) * scale for one in (a, b))
    squares = (y**2).sum(axis=1)
    others = np.hstack([y, b.normals, squares[:, None]])
    close = bool((x**2).sum(axis=1).max() + squares.max() <= _CLOSE)

    def sums(batch: _TileBatch) -> float:
        rows = (np.moveaxis(column[batch.tiles], 2, 1) for column in (x, a.normals))
        found = _tile_sums()(*rows, others[batch.partners], batch.begin, batch.end, batch.weights, WHOLE, close=close)
        return float(found)

    return sums


@lru_cache(maxsize=1)
def _tile_sums() -> Callable[..., Any]:
    """Return the compiled loop: tiles on the minor axis, `_UNROLLED` partners per step, O(nodes) memory."""
    import jax
    import jax.numpy as jnp

    def one_tile(total: jax.Array, row: tuple[jax.Array, ...], others: jax.Array, whole: jax.Array, close: bool) -> Any:
        """Add a tile's sum over its elements and their partners, times its weight, to the total."""
        x, n, first, last, weight = row
        dim = len(x)
        squares, twice = (x**2).sum(axis=0), -2 * x

        def square(y: jax.Array) -> Any:
            if close:
                return sum((twice[i] * y[i] for i in range(dim)), squares + y[2 * dim])
            return sum((x[i] - y[i]) ** 2 for i in range(dim))

        def step(k: jax.Array, sums: jax.Array) -> jax.Array:
            """Add the next few partners to the sums of the tile's elements."""
            some = jax.lax.dynamic_slice(others, (first + k * _UNROLLED, 0), (_UNROLLED, 2 * dim + 1))
            for y in some:
                both = sum(n[i] * y[dim + i] for i in range(dim))
                sums = sums + exp2_of_minus(square(y), whole, bounded=close) * both
            return sums

        sums = jax.lax.fori_loop(0, (last - first) // _UNROLLED, step, jnp.zeros(x.shape[1]))
        return total + weight * sums.sum(), None

    @partial(jax.jit, compiler_options=WIDEST, static_argnames="close")
    def tile_sums(x: Any, n: Any, others: Any, begin: Any, end: Any, weights: Any, whole: Any, close: bool) -> Any:
        task = partial(one_tile, others=others, whole=whole, close=close)
        return jax.lax.scan(task, 0.0, (x, n, begin, end, weights))[0]

    return tile_sums
