"""The inner product of two interfaces as currents: with one point per cell, or to a tolerance whatever their cells.

⟨S,T⟩ = ∫_S ∫_T K(x, y) n(x)·m(y) dy dx with the kernel K = exp(-|x-y|²/2σ²) and unit normals n, m; mm² in the plane,
mm⁴ for surfaces. Eqs. (10)-(11) of the study; σ is its σ_W.

Behind it is the double sum Σ_i Σ_j exp(-|x_i - y_j|²/2σ²) n_i·m_j, for few nodes and for very many. The matrix of all
pairs is never stored: few pairs are summed in blocks, many by a compiled loop over the y of each tile of neighbouring
x. If the kernel is short, a tree finds the y a tile needs. Threads share the batches of tiles. The batches do not
depend on the number of threads, and neither does the sum.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache, partial, reduce
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree
from scipy.special import erf, gammaln, roots_jacobi

from strandline.foundations import WHOLE, WIDEST, NumericsError, double, exp2_of_minus, side_by_side
from strandline.interface import Interface

Pairs = Int[np.ndarray, " pair"]
PANEL = 6.0  # longest piece of a segment that one Gauss rule integrates over, in kernel widths
_FAR = 1e-12
_RADII = np.geomspace(1.05, 1e4, 300)
TRIANGLE = 2.5
"""Radius of the largest triangle that one rule integrates over, in kernel widths; larger ones are divided."""
_HIGHEST = 30
BLOCK = 1 << 16  # pairs of nodes or of pieces that NumPy processes at once; this bounds the memory
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


def centre_product(a: Interface, b: Interface, width: float) -> float:
    """Return Σ_i Σ_j K(c_i, d_j) n_i·m_j, mm² (mm⁴), with cell centres c, d and normals n, m times length (area).

    If there are very many cells, pairs so far apart that they add up to less than 1e-12 of `natural_scale(a)` are left
    out.
    """
    nodes, reach = Nodes(a.centres, a.normals), math.inf
    if len(a.cells) * len(b.cells) > SMALL:
        sizes = float(a.sizes.sum()) * float(b.sizes.sum())
        reach = width * math.sqrt(2 * math.log(max(sizes / natural_scale(a, width) / _FAR, 1.0)))
    return kernel_sum(nodes, nodes if a is b else Nodes(b.centres, b.normals), width, reach=reach)


def natural_scale(a: Interface, width: float) -> float:
    """Return size · min(size, (σ√2π)^k), mm² (mm⁴), of an interface of k dimensions.

    This is ⟨S,S⟩ of a straight line or a plane much larger (or smaller) than the width.
    """
    size = float(a.sizes.sum())
    return size * min(size, (width * math.sqrt(2 * math.pi)) ** (a.dim - 1))


def refined_product(a: Interface, b: Interface, width: float, *, tolerance: float) -> float:
    """Return ⟨a,b⟩ of the polylines themselves, mm², whatever their segmentation.

    The integral over a segment of `b` is in closed form (erf). The one over `a` uses Gauss–Legendre rules on pieces no
    longer than `PANEL` widths, of the order at which their error bound (`gauss_order`) falls below `tolerance`. Pairs
    too far apart to matter at this tolerance are left out. The error is relative to `natural_scale(a)`, if `b` does not
    pass near one point many times. If there are very many segments, Gauss rules integrate over `b` too: with 10 000 a
    side, d² takes 0.6 CPU-seconds, not 20.
    """
    length = float(b.lengths.sum())
    reach = width * math.sqrt(2 * math.log(max(length / min(length, width), 1.0) / tolerance))
    if len(a.cells) * len(b.cells) > SMALL:
        allowed = 0.25 * tolerance * min(length, width) / min(length, 2 * reach)
        nodes = _polyline_nodes(a, width, allowed)
        return kernel_sum(nodes, nodes if a is b else _polyline_nodes(b, width, allowed), width, reach=reach)
    pieces = _Pieces(a, PANEL * width)
    longest = float(pieces.lengths.max())
    order = gauss_order(math.ceil(8 * longest / width) / 8, tolerance)
    rows, size = max(1, BLOCK // len(b.cells)), max(1, BLOCK // order)
    near = (_near_pairs(pieces, b, slice(k, k + rows), reach) for k in range(0, len(pieces.starts), rows))
    return math.fsum(
        _pair_integrals(pieces, b, row[k : k + size], column[k : k + size], width, order)
        for row, column in near
        for k in range(0, len(row), size)
    )


@lru_cache(maxsize=512)
def gauss_order(ratio: float, tolerance: float) -> int:
    """Return how many Gauss–Legendre points integrate the kernel along a piece `ratio` widths long.

    In the complex plane of the arc length the kernel grows as exp(y²/2σ²), where y is the imaginary part. On the
    Bernstein ellipse of radius ρ around the piece it grows by at most exp(ratio²(ρ - 1/ρ)²/32). So the error of m
    points, exact for polynomials up to degree 2m-1, is at most 4 ρ^(1-2m)/(ρ-1) times that, relative to the piece's
    length times the integral of the kernel. The best ρ is used.
    """
    growth = (ratio * (_RADII - 1 / _RADII)) ** 2 / 32
    for order in range(1, 101):
        log_bound = math.log(4) + growth + (1 - 2 * order) * np.log(_RADII) - np.log(_RADII - 1)
        if log_bound.min() <= math.log(tolerance):
            return order
    raise NumericsError(
        f"no Gauss rule integrates a piece of {ratio:g} kernel widths to {tolerance:g}; allow a larger tolerance"
    )


class _Pieces:
    """Equal straight pieces of each segment of a polyline: starts, and steps from start to end, (piece, 2), mm."""

    def __init__(self, polyline: Interface, longest: float) -> None:
        parts = np.maximum(np.ceil(polyline.lengths / longest).astype(int), 1)
        self.steps = np.repeat((polyline.ends - polyline.starts) / parts[:, None], parts, axis=0)
        rank = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
        self.starts = np.repeat(polyline.starts, parts, axis=0) + rank[:, None] * self.steps

    @property
    def lengths(self) -> Float[np.ndarray, " piece"]:
        return np.asarray(np.hypot(self.steps[:, 0], self.steps[:, 1]))


def _polyline_nodes(polyline: Interface, width: float, tolerance: float) -> Nodes:
    """Return Gauss points of the pieces, of the order at which the error bound of each (`gauss_order`) falls below the
    tolerance, and normals there times their shares of the length.
    """
    pieces = _Pieces(polyline, PANEL * width)
    ratios = np.exp2(np.ceil(2 * np.log2(pieces.lengths / width)) / 2)  # at most 1.4 times as long
    points, normals = [], []
    for ratio in np.unique(ratios):
        nodes, weights = _unit_gauss(gauss_order(float(ratio), tolerance))
        starts, steps = pieces.starts[ratios == ratio, None], pieces.steps[ratios == ratio, None]
        points.append((starts + nodes[:, None] * steps).reshape(-1, 2))
        normals.append((weights[:, None] * steps[..., ::-1] * (1.0, -1.0)).reshape(-1, 2))
    return Nodes(np.concatenate(points), np.concatenate(normals))


def _near_pairs(pieces: _Pieces, b: Interface, rows: slice, reach: float) -> tuple[Pairs, Pairs]:
    """Return the pieces and segments that come within `reach` of each other, perhaps a few more."""
    tangents = (b.ends - b.starts) / b.lengths[:, None]
    middle = pieces.starts[rows] + 0.5 * pieces.steps[rows]
    x, y = (middle[:, k, None] - b.starts[:, k] for k in (0, 1))
    along = x * tangents[:, 0] + y * tangents[:, 1]
    beyond = along - np.clip(along, 0.0, b.lengths)
    off = x * tangents[:, 1] - y * tangents[:, 0]
    near = beyond**2 + off**2 <= (reach + 0.5 * pieces.lengths[rows, None]) ** 2
    row, column = np.nonzero(near)
    return row + rows.start, column


def _pair_integrals(pieces: _Pieces, b: Interface, row: Pairs, column: Pairs, width: float, order: int) -> float:
    """Return Σ over the pairs of n·m ∫∫ K; `along` and `across` are the nodes' coordinates in the segment's frame."""
    nodes, weights = _unit_gauss(order)
    scale = 1 / (math.sqrt(2) * width)
    lengths = b.lengths[column]
    t = (b.ends - b.starts)[column] / lengths[:, None]
    start = (pieces.starts[row] - b.starts[column]) * scale
    step = pieces.steps[row] * scale
    cosine = step[:, 0] * t[:, 0] + step[:, 1] * t[:, 1]
    sine = step[:, 1] * t[:, 0] - step[:, 0] * t[:, 1]
    along = (start[:, 0] * t[:, 0] + start[:, 1] * t[:, 1])[:, None] + cosine[:, None] * nodes
    across = (start[:, 1] * t[:, 0] - start[:, 0] * t[:, 1])[:, None] + sine[:, None] * nodes
    inner = np.exp(-(across**2)) * (erf(along) - erf(along - (lengths * scale)[:, None]))
    return float(cosine @ (inner @ weights)) * math.sqrt(math.pi) * width**2


@lru_cache(maxsize=128)
def _unit_gauss(order: int) -> tuple[Float[np.ndarray, " node"], Float[np.ndarray, " node"]]:
    """Return nodes and weights of the Gauss–Legendre rule on [0, 1]."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    return 0.5 * (nodes + 1), 0.5 * weights


def refined_surface_product(a: Interface, b: Interface, width: float, *, tolerance: float) -> float:
    """Return ⟨a,b⟩ of the surfaces themselves, mm⁴, whatever their triangulation.

    Gauss rules on triangles no larger than `TRIANGLE` widths integrate both, each of the order at which its error bound
    (`error_bound`) falls below the tolerance. Pairs too far apart to matter at this tolerance are left out. The error
    is relative to area · min(area, 2πσ²) of `a`, the ⟨a,a⟩ of a plane much larger (or smaller) than the width, if `b`
    does not pass near one point many times.
    """
    (area, other), plane = (float(one.areas.sum()) for one in (a, b)), 2 * math.pi * width**2
    least = min(area, plane)
    reach = width * math.sqrt(2 * math.log(max(2 * other / (least * tolerance), 1.0)))
    near = min(other, math.pi * reach**2)
    allowed = 0.25 * tolerance * least / near
    nodes = surface_nodes(a, width, allowed)
    return kernel_sum(nodes, nodes if a is b else surface_nodes(b, width, allowed), width, reach=reach)


def surface_nodes(surface: Interface, width: float, tolerance: float) -> Nodes:
    """Return quadrature points of a surface, (node, 3) mm, and normals times their shares of the area, (node, 3) mm².

    They integrate the kernel around any point to `tolerance` relative to the area times the kernel's peak.
    """
    corners, normals = surface.points[surface.cells], surface.normals
    radii = _enclosing_radii(corners) / width
    parts = np.maximum(np.ceil(radii / TRIANGLE), 1).astype(int)
    ratios = np.ceil(8 * radii / parts) / 8
    orders = np.array([triangle_order(ratio, tolerance) for ratio in ratios.tolist()])
    points, areas = [], []
    for part, order in np.unique(np.stack([parts, orders]), axis=1).T.tolist():
        some = (parts == part) & (orders == order)
        shares, weights = _divided_rule(part, order)
        points.append(np.einsum("nk,tkx->tnx", shares, corners[some]).reshape(-1, 3))
        areas.append((weights[:, None] * normals[some][:, None]).reshape(-1, 3))
    return Nodes(np.concatenate(points), np.concatenate(areas))


@lru_cache(maxsize=4096)
def triangle_order(ratio: float, tolerance: float) -> int:
    """Return the lowest order of a rule whose error bound on a triangle of radius `ratio` widths is in tolerance."""
    for order in range(1, _HIGHEST + 1):
        if error_bound(order, ratio) <= tolerance:
            return order
    raise NumericsError(
        f"no rule integrates a triangle of radius {ratio:g} kernel widths to {tolerance:g}; allow a larger tolerance"
    )


def error_bound(order: int, ratio: float) -> float:
    """Return a bound on the error of `triangle_rule(order)`, relative to the area times the kernel's peak.

    The kernel is a mean of plane waves exp(ik·x), where k is normal with variance 1/σ² per component. On a disc of
    radius R around the triangle, a polynomial of degree p along k comes within 2 Σ_{n>p} |J_n(|k|R)| ≤
    2 Σ_{n>p} (|k|R/2)ⁿ/n! of such a wave. The rule is exact for p = 2·order-1 and its weights are positive, so its
    error is at most twice the mean of that: 4 Σ_{n>p} (R/√2σ)ⁿ Γ(1+n/2)/n!, with R = ratio · σ.
    """
    n = np.arange(2 * order, 2 * order + 200)
    return float(4 * np.exp(n * math.log(ratio / math.sqrt(2)) + gammaln(1 + n / 2) - gammaln(n + 1)).sum())


@lru_cache(maxsize=64)
def triangle_rule(order: int) -> tuple[Float[np.ndarray, "node 3"], Float[np.ndarray, " node"]]:
    """Return shares of the corners and weights (sum 1) of a rule with order² points, exact up to degree 2·order-1.

    The rule is Gauss–Jacobi along the line from the first corner and Gauss–Legendre across it.
    """
    s, along = roots_jacobi(order, 0, 1)
    t, across = np.polynomial.legendre.leggauss(order)
    s, t = 0.5 * (s + 1), 0.5 * (t + 1)
    shares = np.stack(np.broadcast_arrays(1 - s[:, None], s[:, None] * (1 - t), s[:, None] * t), axis=-1)
    weights = np.outer(along, across).ravel()
    return shares.reshape(-1, 3), weights / weights.sum()


@lru_cache(maxsize=64)
def _divided_rule(parts: int, order: int) -> tuple[Float[np.ndarray, "node 3"], Float[np.ndarray, " node"]]:
    """Return the rule on parts² equal triangles, similar to the whole, that cut each side into `parts`."""
    shares, weights = triangle_rule(order)
    rows, columns = np.divmod(np.arange(parts**2), parts)
    upright = rows + columns < parts
    i, j = (np.where(upright, one, parts - one) for one in (rows, columns))
    k = np.where(upright, parts - 1, parts + 1) - i - j
    lattice, sign = np.stack([i, j, k], axis=1), np.where(upright, 1, -1)
    pieces = (lattice[:, None] + sign[:, None, None] * shares) / parts
    return pieces.reshape(-1, 3), np.tile(weights, parts**2) / parts**2


def _enclosing_radii(corners: Float[np.ndarray, "cell 3 3"]) -> Float[np.ndarray, " cell"]:
    """Return the radius, mm, of the smallest disc that holds each triangle."""
    sides = np.sort(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2), axis=1)
    a, b, c = sides.T
    twice = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    acute = a**2 + b**2 > c**2
    return np.asarray(np.where(acute, a * b * c / (2 * twice), 0.5 * c))
