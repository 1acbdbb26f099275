"""The currents measure on a batch of polylines, exact to its tolerance: Gauss rules on the pieces of both sides.

Neighbours in a batch hardly differ, so most pairs of pieces are too far apart in all of them and are left out. A
compiled loop sums the rest, one pair per step, with the runs on the last axis. Its unit of length is σ_W √(2 ln 2), in
which the kernel is 2^-|x - y|².
"""

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float, Int

from strandline.discrepancy.products.kernel_integrals import PANEL, gauss_order
from strandline.discrepancy.products.piece_sums import Orders, PieceSum, compiled_sum, plain_sum
from strandline.discrepancy.products.pieces import Division, Pairs, Pieces, lengths
from strandline.discrepancy.search.blocks import similar
from strandline.numerics.compiled import ample
from strandline.numerics.threads import double, side_by_side

__all__ = ["Rule", "currents_of_many"]

FEWEST = 16
"""Number of runs from which compiling pays off."""
BLOCK = 256
"""Runs processed together."""
PROBES = 8
"""Runs of a batch on which the orders of the Gauss rules are tried."""
MARGIN = 0.1
"""Share of the tolerance that the probes may use up."""
_UNIT = math.sqrt(2 * math.log(2))
"""Unit of length, in kernel widths."""


@dataclass(frozen=True)
class Rule:
    """Accuracy to which a batch is integrated.

    Args:
        tolerance: Largest error of d², mm².
        share: Largest error of an inner product by the error bound (`gauss_order`), relative to its natural scale;
            None for one point per segment.
    """

    tolerance: float
    share: float | None


def currents_of_many(
    points: Float[np.ndarray, "run point 2"],
    cells: Int[np.ndarray, "cell 2"],
    observed: Float[np.ndarray, "other 2"],
    observed_cells: Int[np.ndarray, "other_cell 2"],
    *,
    width: float,
    square: float,
    rule: Rule,
) -> Float[np.ndarray, " run"] | None:
    """Return d² = ⟨S,S⟩ - 2⟨S,T⟩ + ⟨T,T⟩ of each polyline S, mm²; None for few runs, or with JAX in single precision.

    The Gauss rules have the lowest orders at which the error of some runs, as different as the batch contains, is at
    most a tenth of the tolerance. The orders never exceed those of the error bound.

    Args:
        points: Points of the simulated polylines (run, point, 2), mm.
        cells: Segments of the simulated polylines, two point numbers each.
        observed: Points of the observed polyline T, mm.
        observed_cells: Segments of the observed polyline.
        width: Kernel width σ_W, mm.
        square: ⟨T,T⟩, mm².
        rule: Error allowed.
    """
    if len(points) < FEWEST or not double():
        return None
    unit, middle = _UNIT * width, observed.mean(axis=0)
    (order,) = similar(points, len(points))
    shapes, seen = np.moveaxis((points[order] - middle) / unit, 0, 2), (observed - middle) / unit
    batch = _Batch.of(shapes, cells, seen, observed_cells, Rule(rule.tolerance / unit**2, rule.share))
    orders = batch.orders()
    blocks = np.array_split(np.arange(len(points)), -(-len(points) // BLOCK))
    found = np.empty(len(points))
    found[order] = np.concatenate([*side_by_side(partial(batch.compiled, orders=orders), blocks)])
    return np.maximum(unit**2 * found + square, 0.0)


@dataclass(frozen=True, eq=False)
class _Batch:
    """Polylines S of many runs, sorted by similarity, and the observed one, T.

    Args:
        points: Points of the simulated polylines.
        own: Division of their segments.
        target: Pieces of the observed polyline.
        longest: Longest piece of S and of T, in kernel widths.
        reach: Distance beyond which all pairs together contribute at most a tenth of the tolerance.
        rule: Error allowed, in squares of the unit.
    """

    points: Float[np.ndarray, "point 2 run"]
    own: Division
    target: Pieces
    longest: tuple[float, float]
    reach: float
    rule: Rule

    @classmethod
    def of(
        cls,
        points: Float[np.ndarray, "point 2 run"],
        cells: Int[np.ndarray, "cell 2"],
        observed: Float[np.ndarray, "other 2"],
        observed_cells: Int[np.ndarray, "other_cell 2"],
        rule: Rule,
    ) -> "_Batch":
        """Divide the segments, in units of the width, and find the reach."""
        ours, theirs = lengths(points, cells), lengths(observed, observed_cells)
        panel = PANEL / _UNIT if rule.share else math.inf
        own, target = Division.of(cells, ours.max(axis=1), panel), Division.of(observed_cells, theirs, panel)
        whole = max(float(ours.sum(axis=0).max()), float(theirs.sum()))
        reach = math.sqrt(math.log2(max(whole**2 / (MARGIN * rule.tolerance), 1.0)))
        longest = _UNIT * own.longest, _UNIT * target.longest
        return cls(points, own, target.pieces(observed), longest, reach, rule)

    def orders(self) -> Orders:
        """Return the lowest orders at which no probe's error exceeds a tenth of the tolerance."""
        if self.rule.share is None:
            return 1, 1
        probes = np.unique(np.linspace(0, self.points.shape[2] - 1, PROBES).astype(int))
        *coarser, finest = _ladder(self.longest, self.rule.share)
        exact = self.in_numpy(probes, finest)
        for orders in coarser:
            if abs(self.in_numpy(probes, orders) - exact).max() <= MARGIN * self.rule.tolerance:
                return orders
        return finest

    def compiled(self, rows: Int[np.ndarray, " some"], orders: Orders) -> Float[np.ndarray, " some"]:
        """Return ⟨S,S⟩ - 2⟨S,T⟩ of the runs `rows`, by the compiled loop."""
        padded = np.pad(rows, (0, ample(len(rows)) - len(rows)), mode="edge")
        return self._summed(padded, orders, compiled_sum)[: len(rows)]

    def in_numpy(self, rows: Int[np.ndarray, " some"], orders: Orders) -> Float[np.ndarray, " some"]:
        """Return the same with NumPy: slow, but new orders need no compiling."""
        return self._summed(rows, orders, plain_sum)

    def _summed(self, rows: Int[np.ndarray, " some"], orders: Orders, summed: PieceSum) -> Float[np.ndarray, " some"]:
        own = self.own.pieces(np.ascontiguousarray(self.points[..., rows]))
        square = summed(own, own, Pairs.near(own, own, self.reach), (orders[0], orders[0]))
        cross = summed(own, self.target, Pairs.near(own, self.target, self.reach), orders)
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
