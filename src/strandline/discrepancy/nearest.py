"""The closest points of a polyline or a triangulated surface, found by a tree as reliably as by trying every cell.

The distance to the cell with the nearest centre is an upper bound on the distance to the interface. A tree of boxes
around the cells is then searched for all points at once; a box farther away than the bound contains nothing closer. The
remaining cells are tried, so the result is that of trying every cell, to the last bit, whatever the sizes of the cells.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache, reduce

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from strandline.discrepancy.protocol import Snapshot
from strandline.foundations import InvalidInterface, require
from strandline.interface import Interface

Pairs = Int[np.ndarray, " pair"]
Points = Float[np.ndarray, "point xyz"]
BLOCK = 1 << 15  # pairs of a point and a cell processed at once; this bounds the memory
SMALL = 1 << 14  # number of pairs of a point and a cell up to which trying all of them is faster than the tree
ONCE = 1 << 17  # the same if the interface is searched only once, so that its tree is not kept
_LEAF = 3  # smallest number of cells in the lowest boxes of the tree; the largest is less than twice that
_GUESS = 0.02  # allowed error of the first bound, as a share of it; it saves distant points most of the search for it
_SLACK = 1e-9, 1e-14
"""How much farther than the bound a box may be: far more than rounding, as a share of the bound and of the extent."""

Vectors = Float[np.ndarray, "xyz *#pair"]


@dataclass(frozen=True, eq=False)
class ClosestPoints:
    """Closest points of an interface, mm, the cells that they lie on, the first of several; squared distances, mm²."""

    points: Points
    cells: Int[np.ndarray, " point"]
    squares: Float[np.ndarray, " point"]


def squared_distances(points: Points, target: Interface) -> Float[np.ndarray, " point"]:
    """Return the squared distance, mm², of each point to the closest point of `target`, on its cells."""
    return closest_points(points, target).squares


def closest_points(points: Points, target: Interface, *, once: bool = False) -> ClosestPoints:
    """Return the closest points of `target`, on its segments or triangles.

    The search trees are kept for the most recently searched interfaces. With `once`, the interface will not be searched
    again, as a prediction that is looked at once.
    """
    what, found = "points to project onto an interface", f"{points.shape[1]} coordinates"
    words = f"{target.dim} coordinates, as the interface has", "Compare like with like."
    require(points.shape[1] == target.dim, what, found, *words, InvalidInterface)
    if len(points) * len(target.cells) <= (ONCE if once else SMALL):
        return brute_force(points, target)
    return by_tree(points, target)


def brute_force(points: Points, target: Interface) -> ClosestPoints:
    """Return the closest points by trying every cell for every point."""
    best = _Best(points, target)
    size = max(1, BLOCK // len(target.cells))
    cells = _corners(target, np.arange(len(target.cells))[None])
    for first in range(0, len(points), size):
        block = slice(first, first + size)
        squares = _squares(points[block].T[:, :, None], cells)
        best.cells[block] = np.argmin(squares, axis=1)
        best.squares[block] = squares[np.arange(len(squares)), best.cells[block]]
    return best.found()


def by_tree(points: Points, target: Interface) -> ClosestPoints:
    """Return the closest points by searching the tree."""
    best, tree = _Best(points, target), _tree(Snapshot.of(target))
    for rows in np.split(np.arange(len(points)), range(BLOCK, len(points), BLOCK)):
        best.look_at(rows, tree.centres.query(points[rows], eps=_GUESS)[1])
        tree.look(best, rows, np.zeros_like(rows), 0)
    return best.found()


class _Best:
    """The closest cell found so far for each point, and its squared distance."""

    def __init__(self, points: Points, target: Interface) -> None:
        self.points, self.target = points, target
        self.columns = np.ascontiguousarray(points.T)
        self.cells = np.full(len(points), -1)
        self.squares = np.full(len(points), np.inf)
        self.rounding = _SLACK[1] * max(float(np.abs(x).max(initial=0.0)) for x in (points, target.points))

    def reach(self, rows: Pairs) -> Float[np.ndarray, " pair"]:
        """Return the square of the distance within which a closer cell may lie, plus a margin for rounding."""
        return np.asarray((np.sqrt(self.squares.take(rows)) * (1 + _SLACK[0]) + self.rounding) ** 2)

    def look_at(self, rows: Pairs, cells: Pairs) -> None:
        """Try these pairs of a point and a cell, `rows` in ascending order; if cells tie, the first is kept."""
        if rows.size == 0:
            return
        squares = _squares(self.columns.take(rows, axis=1), _corners(self.target, cells))
        first = np.flatnonzero(np.diff(rows, prepend=-1))
        least = np.minimum.reduceat(squares, first)
        counts = np.diff(first, append=len(rows))
        tied = np.where(squares == np.repeat(least, counts), cells, len(self.target.cells))
        cell, rows = np.minimum.reduceat(tied, first), rows[first]
        better = (least < self.squares[rows]) | ((least == self.squares[rows]) & (cell < self.cells[rows]))
        self.squares[rows[better]], self.cells[rows[better]] = least[better], cell[better]

    def found(self) -> ClosestPoints:
        residuals = np.stack(list(_residuals(self.columns, _corners(self.target, self.cells))))
        best = np.argmin(_dot(np.moveaxis(residuals, 1, 0), np.moveaxis(residuals, 1, 0)), axis=0)
        closest = self.columns - np.take_along_axis(residuals, best[None, None], axis=0)[0]
        return ClosestPoints(closest.T.copy(), self.cells, self.squares)


@dataclass(frozen=True, eq=False)
class _Tree:
    """Boxes around cells near each other, halved from level to level, and a tree of the cells' centres. `order` has the
    number of the cell in each of the lowest boxes; some are repeated to fill all boxes equally. `levels` has the
    corners (low, high) of the boxes, (2, xyz, box): 1, 2, 4, …, and finally one for each cell.
    """

    centres: cKDTree
    order: Int[np.ndarray, " place"]
    levels: list[Float[np.ndarray, "2 xyz _"]]

    def look(self, best: _Best, rows: Pairs, boxes: Pairs, level: int) -> None:
        """Improve the best with the cells in the boxes, each box paired with the point of its row."""
        if len(rows) > BLOCK:
            half = len(rows) // 2
            self.look(best, rows[:half], boxes[:half], level)
            self.look(best, rows[half:], boxes[half:], level)
            return
        square, (low, high) = np.zeros(len(rows)), self.levels[level]
        for k in range(len(low)):
            x = best.columns[k].take(rows)
            apart = np.maximum(np.maximum(low[k].take(boxes) - x, x - high[k].take(boxes)), 0.0)
            square += apart * apart
        near = square <= best.reach(rows)
        rows, boxes = rows[near], boxes[near]
        if level == len(self.levels) - 1:
            best.look_at(rows, self.order[boxes])
        elif len(rows):
            parts = self.levels[level + 1].shape[2] // self.levels[level].shape[2]
            inner = (parts * boxes[:, None] + np.arange(parts)).ravel()
            self.look(best, np.repeat(rows, parts), inner, level + 1)


@lru_cache(maxsize=8)
def _tree(snapshot: Snapshot) -> _Tree:
    target = snapshot.interface
    number = len(target.cells)
    halvings = max((number // _LEAF).bit_length() - 1, 0)
    leaf = -(-number // 2**halvings)
    centres = target.centres
    order = cKDTree(centres, leafsize=leaf).indices[np.arange(leaf * 2**halvings) * number // (leaf * 2**halvings)]
    corners = _corners(target, order)
    levels = [np.stack([reduce(np.minimum, corners), reduce(np.maximum, corners)])]
    for parts in [leaf] + [2] * (halvings % 2) + [4] * (halvings // 2):
        low, high = levels[0]
        low = reduce(np.minimum, (low[:, k::parts] for k in range(parts)))
        high = reduce(np.maximum, (high[:, k::parts] for k in range(parts)))
        levels.insert(0, np.stack([low, high]))
    return _Tree(cKDTree(centres), order, levels)


def _corners(target: Interface, which: Int[np.ndarray, "*#pair"]) -> list[Float[np.ndarray, "xyz ..."]]:
    """Return the corners of these cells; `take` takes a fifth of the time of indexing with lists."""
    columns = np.ascontiguousarray(target.points.T)
    return [columns.take(corner.take(which), axis=1) for corner in target.cells.T]


def _squares(p: Vectors, corners: list[Vectors]) -> Float[np.ndarray, "..."]:
    """Return the squared distances of points (xyz, pair) to cells; shapes may broadcast."""
    return np.asarray(reduce(np.minimum, (_dot(r, r) for r in _residuals(p, corners))))


def _residuals(p: Vectors, corners: list[Vectors]) -> Iterator[Vectors]:
    """Yield p minus the closest point of each side, and of a triangle's inside; inf if that lies outside."""
    a, b, *more = corners
    yield _off_segment(p, a, b)
    for c in more:
        yield _off_segment(p, b, c)
        yield _off_segment(p, c, a)
        yield _off_inside(p, a, b, c)


def _off_segment(p: Vectors, a: Vectors, b: Vectors) -> Vectors:
    d, q = b - a, p - a
    return np.asarray(q - np.clip(_dot(q, d) / _dot(d, d), 0.0, 1.0) * d)


def _off_inside(p: Vectors, a: Vectors, b: Vectors, c: Vectors) -> Vectors:
    """Solve for the share of c along the altitude, then for that of b: as accurate for slivers as for others. The
    altitude is made orthogonal twice, because for a sliver only rounding is left after the first time.
    """
    d, e, q = b - a, c - a, p - a
    square = _dot(d, d)
    altitude = e - _dot(e, d) / square * d
    altitude = altitude - _dot(altitude, d) / square * d
    w = _dot(q, altitude) / _dot(e, altitude)
    r = q - w * e
    v = _dot(r, d) / square
    inside = (v >= 0) & (w >= 0) & (v + w <= 1)
    return np.where(inside, r - v * d, np.inf)


def _dot(a: Vectors, b: Vectors) -> Float[np.ndarray, "..."]:
    """Return dot products, summed in a fixed order so that a pair always gives the same result to the last bit."""
    return np.asarray(reduce(np.add, (x * y for x, y in zip(a, b, strict=True))))
