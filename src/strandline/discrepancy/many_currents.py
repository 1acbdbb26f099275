"""The currents measure on a batch of polylines, exact to its tolerance: Gauss rules on the pieces of both sides.

⟨a,b⟩ = Σ over pairs of pieces of h·g Σ_ξ Σ_η w_ξ w_η K(x + ξh, y + ηg), with middles x, y, halves h, g and
Gauss–Legendre nodes ξ, η and weights on [-1, 1]. The unit of length is σ_W √(2 ln 2): the kernel K is 2^-|x - y|².
Neighbours in a batch hardly differ, so most pairs of pieces are too far apart in all of them and are left out. A
compiled loop sums the rest, one pair per step, with the runs on the last axis.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from strandline.discrepancy.kernel_integrals import PANEL, gauss_order
from strandline.discrepancy.many_distances import FEWEST, similar
from strandline.foundations import WHOLE, WIDEST, double, exp2_of_minus, side_by_side

Cells = Int[np.ndarray, "cell 2"]
Orders = tuple[int, int]
"""Number of Gauss points on a piece of one side and of the other."""
_CHUNK = 1 << 15
"""Numbers that NumPy processes at once."""
_PIECES = 64
"""The number of pieces is padded to a multiple of this."""
_FARTHEST, _STEEPEST = 900.0, 200.0
"""Limits of exponents, to avoid overflow; only pairs so far apart that they contribute nothing reach them."""
BLOCK, FEWEST_PAIRS = 128, 2048
"""Runs processed together; least length of arrays of pairs. Arrays are padded to few lengths: each takes 0.2 s to trace
and 0.4 s to compile."""
PROBES = 8
"""Runs of a batch on which the orders of the Gauss rules are tried."""
MARGIN = 0.1
"""Share of the tolerance that the probes may use up."""
_UNIT = math.sqrt(2 * math.log(2))
"""Unit of length, in kernel widths."""


def lengths(points: Float[np.ndarray, "point 2 *run"], cells: Cells) -> Float[np.ndarray, "cell *run"]:
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
    """How segments are divided into equal pieces, and the length of the longest one.

    `corners` are numbers of the two points of each piece's segment; `begin`, where the piece begins, and `share`, its
    length, are shares of the segment.
    """

    corners: Int[np.ndarray, "piece 2"]
    begin: Float[np.ndarray, " piece"]
    share: Float[np.ndarray, " piece"]
    longest: float

    @classmethod
    def of(cls, cells: Cells, most: Float[np.ndarray, " cell"], panel: float) -> "Division":
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
class PiecePairs:
    """Pairs of a piece `row` of one side and a piece `column` of the other; each counts `times`."""

    row: Int[np.ndarray, " pair"]
    column: Int[np.ndarray, " pair"]
    times: Float[np.ndarray, " pair"]

    @classmethod
    def near(cls, a: Pieces, b: Pieces, reach: float) -> "PiecePairs":
        """Return the pairs whose boxes come within `reach` of each other; for a side with itself, each pair once."""
        (low_a, high_a), (low_b, high_b) = a.boxes(), b.boxes()
        gap = np.maximum(np.maximum(low_a[:, None] - high_b, low_b - high_a[:, None]), 0.0)
        row, column = np.nonzero(np.hypot(gap[..., 0], gap[..., 1]) <= reach)
        if a is not b:
            return cls(row, column, np.ones(len(row)))
        once = row <= column
        row, column = row[once], column[once]
        return cls(row, column, np.where(row < column, 2.0, 1.0))


PieceSum = Callable[[Pieces, Pieces, PiecePairs, Orders], Float[np.ndarray, " run"]]


def plain_sum(a: Pieces, b: Pieces, pairs: PiecePairs, orders: Orders) -> Float[np.ndarray, " run"]:
    """Return ⟨a,b⟩ of each run, in squares of the unit; `b` may be the same for all runs."""
    (nodes, weights), (others, other_weights) = (np.polynomial.legendre.leggauss(order) for order in orders)
    total = np.zeros(a.middles.shape[2])
    size = max(1, _CHUNK // len(total))
    for k in range(0, len(pairs.row), size):
        i, j = pairs.row[k : k + size], pairs.column[k : k + size]
        h, g = a.halves[i], b.halves[j].reshape(len(j), 2, -1)
        apart = a.middles[i] - b.middles[j].reshape(g.shape)
        kernel = np.zeros((len(i), len(total)))
        for x, w in zip(nodes, weights, strict=True):
            for y, v in zip(others, other_weights, strict=True):
                kernel += w * v * np.exp2(-((apart + x * h - y * g) ** 2).sum(axis=1))
        total += pairs.times[k : k + size] @ (kernel * (h * g).sum(axis=1))
    return total


def compiled_sum(a: Pieces, b: Pieces, pairs: PiecePairs, orders: Orders) -> Float[np.ndarray, " run"]:
    """Return the same, with JAX in double precision."""
    number = len(pairs.row)
    room = max(FEWEST_PAIRS, 1 << max(number - 1, 0).bit_length()) - number
    rows = tuple(np.pad(some, (0, room)) for some in (pairs.row, pairs.column, pairs.times))
    ours, theirs = (tuple(_padded(some) for some in (side.middles, side.halves)) for side in (a, b))
    return np.asarray(_loop()(ours, theirs, rows, number, WHOLE, orders=orders))


def _padded(pieces: Float[np.ndarray, "piece 2 *run"]) -> Float[np.ndarray, "more 2 *run"]:
    """Return pieces with more behind them, which no pair refers to."""
    room = -len(pieces) % _PIECES
    return np.pad(pieces, ((0, room), *((0, 0),) * (pieces.ndim - 1)))


@lru_cache(maxsize=1)
def _loop() -> Any:
    """Return the compiled loop over the pairs, with the runs on the last axis."""
    import jax
    import jax.numpy as jnp

    @partial(jax.jit, compiler_options=WIDEST, static_argnames="orders")
    def loop(ours: Any, theirs: Any, rows: Any, number: Any, whole: Any, *, orders: Orders) -> Any:
        """Sum the contributions of the pairs in turn."""
        (middles, halves), (others, other_halves), (row, column, times) = ours, theirs, rows

        def add(k: Any, total: Any) -> Any:
            i, j = row[k], column[k]
            apart = [middles[i, axis] - others[j, axis] for axis in (0, 1)]
            h, g = [halves[i, axis] for axis in (0, 1)], [other_halves[j, axis] for axis in (0, 1)]
            return total + times[k] * _pair(apart, h, g, whole, orders)

        return jax.lax.fori_loop(0, number, add, jnp.zeros(middles.shape[2]))

    return loop


@lru_cache(maxsize=1)
def _power() -> Any:
    """Return the bounded `exp2_of_minus`, which `jax.jit` traces once, not for each pair of nodes."""
    import jax

    return jax.jit(partial(exp2_of_minus, bounded=True))


def _pair(apart: Any, h: Any, g: Any, whole: Any, orders: Orders) -> Any:
    """Return the contribution of one pair of pieces.

    |d + ξh - ηg|² = |d|² + (ξ²|h|² + 2ξ d·h) + (η²|g|² - 2η d·g) - 2ξη h·g: the kernel is a product of four powers.
    Only the one with h·g depends on both nodes; a pair of nodes and the opposite pair share it.
    """
    import jax.numpy as jnp

    power = partial(_power(), whole=whole)
    both = _dot(h, g)
    zero, ours = _powers(power, _dot(h, h), 2 * _dot(apart, h), orders[0])
    other_zero, theirs = _powers(power, _dot(g, g), -2 * _dot(apart, g), orders[1])
    total = zero * other_zero
    for _, ahead, behind in theirs:
        total += zero * (ahead + behind)
    for x, ahead, behind in ours:
        total += other_zero * (ahead + behind)
        for y, other_ahead, other_behind in theirs:
            twist = 2 * (x * y)
            total += power(-twist * both) * (ahead * other_ahead + behind * other_behind)
            total += power(twist * both) * (ahead * other_behind + behind * other_ahead)
    return total * power(jnp.minimum(_dot(apart, apart), _FARTHEST)) * both


def _powers(power: Any, square: Any, slope: Any, order: int) -> tuple[float, list[tuple[float, Any, Any]]]:
    """Return the weight of the node 0, and each positive node ξ with w_ξ 2^-(ξ² square ± ξ slope)."""
    import jax.numpy as jnp

    slope = jnp.clip(slope, -_STEEPEST, _STEEPEST)
    nodes, weights = np.polynomial.legendre.leggauss(order)
    positive = zip(nodes[(order + 1) // 2 :].tolist(), weights[(order + 1) // 2 :].tolist(), strict=True)
    return float(weights[order // 2]) * (order % 2), [
        (x, w * power(x * x * square + x * slope), w * power(x * x * square - x * slope)) for x, w in positive
    ]


def _dot(a: Any, b: Any) -> Any:
    return a[0] * b[0] + a[1] * b[1]


def currents_of_many(
    points: Float[np.ndarray, "run point 2"],
    cells: Cells,
    observed: Float[np.ndarray, "other 2"],
    observed_cells: Int[np.ndarray, "other_cell 2"],
    *,
    width: float,
    square: float,
    tolerance: float,
    share: float | None,
) -> Float[np.ndarray, " run"] | None:
    """Return d² = ⟨S,S⟩ - 2⟨S,T⟩ + ⟨T,T⟩ of each polyline S, mm²; None for few runs, or with JAX in single precision.

    The Gauss rules have the lowest orders at which the error of some runs, as different as the batch contains, is at
    most a tenth of the tolerance. The orders never exceed those of the error bound.

    Lengths are in mm; `square` is ⟨T,T⟩ and `tolerance` the largest error of d², mm². `share` is the largest error of
    an inner product by the error bound (`gauss_order`), relative to its natural scale; None: one point per segment.
    """
    if len(points) < FEWEST or not double():
        return None
    unit, middle = _UNIT * width, observed.mean(axis=0)
    (order,) = similar(points, len(points))
    shapes, seen = np.moveaxis((points[order] - middle) / unit, 0, 2), (observed - middle) / unit
    batch = _Batch(shapes, cells, seen, observed_cells, tolerance / unit**2, share)
    orders = batch.orders()
    blocks = np.split(np.arange(len(points)), range(BLOCK, len(points), BLOCK))
    found = np.empty(len(points))
    found[order] = np.concatenate([*side_by_side(partial(batch.compiled, orders=orders), blocks)])
    return np.maximum(unit**2 * found + square, 0.0)


class _Batch:
    """Polylines S of many runs, sorted by similarity, and the observed one, T.

    `longest` are the longest pieces of S and of T, in kernel widths, `reach` is the distance beyond which all pairs
    together contribute at most a tenth of the `tolerance`, the largest error of d², in squares of the unit. `share` is
    that of an inner product, see `currents_of_many`.
    """

    def __init__(
        self,
        points: Float[np.ndarray, "point 2 run"],
        cells: Cells,
        observed: Float[np.ndarray, "other 2"],
        observed_cells: Int[np.ndarray, "other_cell 2"],
        tolerance: float,
        share: float | None,
    ) -> None:
        ours, theirs = lengths(points, cells), lengths(observed, observed_cells)
        panel = PANEL / _UNIT if share else math.inf
        self.own, target = Division.of(cells, ours.max(axis=1), panel), Division.of(observed_cells, theirs, panel)
        whole = max(float(ours.sum(axis=0).max()), float(theirs.sum()))
        self.reach = math.sqrt(math.log2(max(whole**2 / (MARGIN * tolerance), 1.0)))
        self.longest = _UNIT * self.own.longest, _UNIT * target.longest
        self.points, self.target, self.tolerance, self.share = points, target.pieces(observed), tolerance, share

    def orders(self) -> Orders:
        """Return the lowest orders at which no probe's error exceeds a tenth of the tolerance."""
        if self.share is None:
            return 1, 1
        probes = np.unique(np.linspace(0, self.points.shape[2] - 1, PROBES).astype(int))
        *coarser, finest = _ladder(self.longest, self.share)
        exact = self._summed(probes, finest, plain_sum)  # with NumPy: slow, but new orders need no compiling
        for orders in coarser:
            if abs(self._summed(probes, orders, plain_sum) - exact).max() <= MARGIN * self.tolerance:
                return orders
        return finest

    def compiled(self, rows: Int[np.ndarray, " some"], orders: Orders) -> Float[np.ndarray, " some"]:
        """Return ⟨S,S⟩ - 2⟨S,T⟩ of the runs `rows`, by the compiled loop."""
        length = BLOCK // 4 if len(rows) <= BLOCK // 4 else BLOCK
        padded = np.pad(rows, (0, length - len(rows)), mode="edge")
        return self._summed(padded, orders, compiled_sum)[: len(rows)]

    def _summed(self, rows: Int[np.ndarray, " some"], orders: Orders, summed: PieceSum) -> Float[np.ndarray, " some"]:
        own = self.own.pieces(np.ascontiguousarray(self.points[..., rows]))
        square = summed(own, own, PiecePairs.near(own, own, self.reach), (orders[0], orders[0]))
        cross = summed(own, self.target, PiecePairs.near(own, self.target, self.reach), orders)
        return np.asarray(square - 2 * cross)


def _ladder(longest: tuple[float, float], share: float) -> list[Orders]:
    """Return orders for pieces of these lengths, in kernel widths, up to those that the error bound requires.

    There are few different ones, because each is compiled for: above 4, only even ones.
    """
    shares = [10.0**-k for k in range(1, math.ceil(-math.log10(share)))] + [share]
    return [*dict.fromkeys((_few(longest[0], some), _few(longest[1], some)) for some in shares)]


def _few(longest: float, share: float) -> int:
    order = gauss_order(math.ceil(2 * longest) / 2, share)
    return order if order <= 4 else order + order % 2
