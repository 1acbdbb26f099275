"""The interface: what a forward model returns and an experiment observes."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from strandline.foundations import InvalidInterface
from strandline.interface import triangles

Point = Float[np.ndarray, "2"]
Corners = Float[np.ndarray, "*#other 2"]
_ROUNDING = 8 * float(np.finfo(float).eps)
"""Share of an interface's extent below which two of its points count as touching."""
_PAIRS = 1 << 18
"""Number of pairs of segments examined together."""
_WIDTH, _MARGIN = 420.0, 8.0
"""Width of a drawing and of its margin, pixels."""
_LEAST, _MOST = 40.0, 420.0
"""Smallest and largest height of a drawing, pixels."""


@dataclass(frozen=True, eq=False)
class Interface:
    """A polyline in the plane or a triangulated surface in space; lengths in mm.

    Args:
        points: node coordinates (point, xyz).
        cells: node numbers of the segments (cell, 2) or triangles (cell, 3).

    Segments run along the interface, each from the end of the last one, with the solid always on the same side; the
    order of the two nodes fixes the normal. Triangles may come in any order, all with the solid on the same side: seen
    from the tip of the normal, the corners run counter-clockwise.

    Raises:
        InvalidInterface: fewer points than one cell needs, a value that is not finite, segments in space or triangles
            in the plane, a cell of zero size, a cell with a node that does not exist, segments that form no chain, or
            a point of a surface that belongs to no triangle.
    """

    points: Float[np.ndarray, "point xyz"]
    cells: Int[np.ndarray, "cell corner"]

    def __repr__(self) -> str:
        kind = "polyline" if self.dim == 2 else "surface"
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        extent = " × ".join(f"{side:.3g}" for side in (high - low).tolist())
        return f"<Interface: {kind} of {len(self.points)} points, {extent} mm>"

    def _repr_svg_(self) -> str | None:
        """Return a drawing of a polyline for a notebook; a surface has none."""
        return _drawn(self.points) if self.dim == 2 else None

    def __post_init__(self) -> None:
        if len(self.points) < self.cells.shape[1] or len(self.cells) == 0:
            raise InvalidInterface(
                "too few points for an interface",
                value=f"{len(self.points)} point(s)",
                expected=f"at least {self.cells.shape[1]}",
                remedy="Supply the whole interface.",
            )
        if not np.isfinite(self.points).all():
            where = int(np.argmax(~np.isfinite(self.points).all(axis=1)))
            raise InvalidInterface(
                f"point {where + 1} of the interface is not finite",
                value=self.points[where].tolist(),
                expected="finite coordinates in mm",
                remedy="Remove or correct the point.",
            )
        self._require_dim()
        self._require_chain()
        if self.dim == 3:
            self._require_areas()
        elif (self.lengths == 0).any():
            where = int(np.argmax(self.lengths == 0))
            raise InvalidInterface(
                f"segment {where + 1} of the interface has no length",
                value=self.points[self.cells[where, 0]].tolist(),
                expected="consecutive points that differ",
                remedy="Remove the repeated point.",
            )

    @classmethod
    def polyline(cls, points: Float[np.ndarray, "point 2"], *, closed: bool = False) -> "Interface":
        """Return the open (or closed) polyline through points (point, 2) in their order."""
        points = np.ascontiguousarray(points, dtype=float)
        first = np.arange(len(points) if closed else max(len(points) - 1, 0))
        return cls(points, np.stack([first, (first + 1) % max(len(points), 1)], axis=1))

    @property
    def dim(self) -> int:
        """Number of coordinates, 2 (a polyline) or 3 (a surface)."""
        return int(self.points.shape[1])

    @property
    def closed(self) -> bool:
        """Whether a polyline returns to its first point; whether a surface has no edge and faces one side."""
        if self.dim == 3:
            return triangles.encloses(self.points, self.cells)
        return bool(self.cells[-1, -1] == self.cells[0, 0])

    @property
    def starts(self) -> Float[np.ndarray, "cell 2"]:
        """First node of each segment."""
        self._require(2)
        return np.asarray(self.points[self.cells[:, 0]])

    @property
    def ends(self) -> Float[np.ndarray, "cell 2"]:
        """Second node of each segment."""
        self._require(2)
        return np.asarray(self.points[self.cells[:, 1]])

    @property
    def lengths(self) -> Float[np.ndarray, " cell"]:
        """Segment lengths, mm."""
        with np.errstate(over="ignore"):  # coordinates like 1e160, which comparisons of interfaces refuse
            return np.asarray(np.linalg.norm(self.ends - self.starts, axis=1))

    @property
    def areas(self) -> Float[np.ndarray, " cell"]:
        """Triangle areas, mm²."""
        self._require(3)
        return np.asarray(np.linalg.norm(triangles.vector_areas(self.points, self.cells), axis=1))

    @property
    def sizes(self) -> Float[np.ndarray, " cell"]:
        """Segment lengths, mm, or triangle areas, mm²."""
        return self.areas if self.dim == 3 else self.lengths

    @property
    def centres(self) -> Float[np.ndarray, "cell xyz"]:
        """Cell centres, mm."""
        return np.asarray(self.points[self.cells].mean(axis=1))

    @property
    def normals(self) -> Float[np.ndarray, "cell xyz"]:
        """Normals times size: of a segment the tangent turned by +90°, mm; of a triangle the right-hand normal, mm²."""
        if self.dim == 3:
            return triangles.vector_areas(self.points, self.cells)
        tangent = self.ends - self.starts
        return np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)

    def reversed(self) -> "Interface":
        """Return the same polyline in the other direction, or the same surface facing the other side."""
        if self.dim == 3:
            return Interface(self.points, np.ascontiguousarray(self.cells[:, ::-1]))
        return Interface.polyline(self.points[::-1], closed=self.closed)

    def resampled(self, number: int, *, start: float = 0.0) -> "Interface":
        """Return the polyline through `number` of its points, equally spaced by arclength.

        An open one keeps its two ends; a closed one begins after the share `start` of its length.
        """
        arclength = np.concatenate([[0.0], np.cumsum(self.lengths)])
        wanted = np.linspace(0.0, arclength[-1], number, endpoint=not self.closed)
        if self.closed:
            wanted = (wanted + start * arclength[-1]) % arclength[-1]
        return Interface.polyline(self._at(wanted, arclength), closed=self.closed)

    def runs_against(self, other: "Interface") -> bool:
        """Return whether `other`, roughly the same interface, runs from the other end or faces the other side.

        Open polylines are compared point by point at equal shares of their length, closed ones by the sign of the
        area they enclose; two closed surfaces by the sign of the volume they enclose; other surfaces, and an open
        polyline with a closed one, by the mean cosine between the normals of cells that are near each other.

        Raises:
            InvalidInterface: one is a polyline, the other a surface.
        """
        if self.dim != other.dim:
            raise InvalidInterface(
                "orientation of one interface like another",
                value=f"points with {self.dim} and with {other.dim} coordinates",
                expected="two polylines or two surfaces",
                remedy="Compare like with like.",
            )
        if self.dim == 3:
            return self._faces_away(other)
        if self.closed != other.closed:
            arc, ring = (self, other) if other.closed else (other, self)
            nearest = cKDTree(ring.centres).query(arc.centres)[1]
            return bool((arc.normals * ring.normals[nearest]).sum() < 0)
        if self.closed:
            return bool(self._signed_area() * other._signed_area() < 0)
        mine, theirs = self._shares, other._shares
        return bool(np.sum((mine - theirs[::-1]) ** 2) < np.sum((mine - theirs) ** 2))

    def require_simple(self, remedy: str = "Sort the points along the interface or remove the loop.") -> None:
        """Refuse a polyline that crosses or touches itself.

        Raises:
            InvalidInterface: it does; the message names the two segments, counted from 1, and the place.
        """
        crossing = self._first_crossing()
        if crossing is not None:
            i, j, place = crossing
            raise InvalidInterface(
                f"the interface crosses itself: segments {i + 1} and {j + 1}",
                value=f"({place[0]:.6g}, {place[1]:.6g}) mm",
                expected="a polyline without crossings, its points in order along the interface",
                remedy=remedy,
            )

    def _require(self, dim: int) -> None:
        if self.dim != dim:
            has = {2: "a polyline, which has lengths, starts and ends", 3: "a surface, which has areas"}
            raise InvalidInterface(
                "kind of interface",
                value=has[self.dim],
                expected={2: "a polyline in the plane", 3: "a surface in space"}[dim],
                remedy="Either has centres, normals and sizes.",
            )

    def _require_dim(self) -> None:
        if self.dim != self.cells.shape[1] or self.dim not in (2, 3):
            raise InvalidInterface(
                "kind of interface",
                value=f"points with {self.dim} coordinates, cells with {self.cells.shape[1]} corners",
                expected="segments in the plane (2 and 2) or triangles in space (3 and 3)",
                remedy="Project a polyline into its plane; give a plane surface a third coordinate.",
            )

    def _require_areas(self) -> None:
        altitudes = triangles.shortest_altitudes(self.points, self.cells)
        flat = altitudes <= _ROUNDING * float(np.abs(self.points).max())
        if flat.any():
            where = int(np.argmax(flat))
            raise InvalidInterface(
                f"triangle {where + 1} of the interface has no area",
                value=self.points[self.cells[where]].tolist(),
                expected="three corners that are not on one line",
                remedy="Remove the triangle, or merge the points that coincide.",
            )
        unused = np.bincount(self.cells.ravel(), minlength=len(self.points)) == 0
        if unused.any():
            raise InvalidInterface(
                f"point {int(np.argmax(unused)) + 1} of the surface belongs to no triangle",
                value=f"{int(unused.sum())} such point(s)",
                expected="every point a corner",
                remedy="Leave such points out and renumber the corners.",
            )

    def _require_chain(self) -> None:
        if self.cells.min() < 0 or self.cells.max() >= len(self.points):
            found, wanted = (
                [int(self.cells.min()), int(self.cells.max())],
                f"numbers from 0 to {len(self.points) - 1}",
            )
        elif self.cells.shape[1] == 2 and (self.cells[1:, 0] != self.cells[:-1, 1]).any():
            where = int(np.argmax(self.cells[1:, 0] != self.cells[:-1, 1]))
            found, wanted = self.cells[where : where + 2].tolist(), "each segment to start where the last one ends"
        else:
            return
        raise InvalidInterface(
            "nodes of the cells",
            value=found,
            expected=wanted,
            remedy="Use Interface.polyline for points in their order."
            if self.cells.shape[1] == 2
            else "Correct the corners.",
        )

    def _faces_away(self, other: "Interface") -> bool:
        if self.closed and other.closed:
            volumes = (triangles.signed_volume(one.points, one.cells) for one in (self, other))
            return math.prod(volumes) < 0
        return triangles.agreement(self.centres, self.normals, other.centres, other.normals) < 0

    @property
    def _shares(self) -> Float[np.ndarray, "share xyz"]:
        """Points at equal shares of the length."""
        arclength = np.concatenate([[0.0], np.cumsum(self.lengths)])
        return self._at(np.linspace(0.0, arclength[-1], 17), arclength)

    def _at(
        self, wanted: Float[np.ndarray, " place"], arclength: Float[np.ndarray, " node"]
    ) -> Float[np.ndarray, "place xyz"]:
        chain = self.points[np.append(self.cells[:, 0], self.cells[-1, 1])]
        return np.stack([np.interp(wanted, arclength, chain[:, k]) for k in range(self.dim)], axis=1)

    def _signed_area(self) -> float:
        """Area to the left, mm²; an open polyline is closed by its chord."""
        origin = self.points[self.cells[0, 0]]
        return float(0.5 * _cross(self.starts - origin, self.ends - origin).sum())

    def _first_crossing(self) -> tuple[int, int, Point] | None:
        """Return (i, j, place) of the first pair of segments that share a point; of neighbours, more than a node."""
        fold = self._first_fold()
        if fold is not None:
            return fold
        slack = _ROUNDING * float(np.ptp(self.points, axis=0).max())
        found = min(_meeting(self.starts, self.ends, slack, closed=self.closed), default=None)
        if found is None:
            return None
        i, j = found
        return i, j, _shared_point(self.starts[i], self.ends[i], self.starts[j], self.ends[j])

    def _first_fold(self) -> tuple[int, int, Point] | None:
        """Return (i, j, place) of the first segment j that runs back over the segment i before it."""
        d = (self.ends - self.starts) / self.lengths[:, None]
        onward = d if self.closed else d[:-1]
        after = np.roll(d, -1, axis=0) if self.closed else d[1:]
        fold = np.flatnonzero((np.abs(_cross(onward, after)) <= _ROUNDING) & (np.sum(onward * after, axis=1) < 0))
        return None if fold.size == 0 else (int(fold[0]), int(fold[0] + 1) % len(d), self.ends[fold[0]])


def _drawn(points: Float[np.ndarray, "point 2"]) -> str:
    """Return an SVG of the polyline through some points, y upwards, with equal scales along both axes."""
    low, sides = points.min(axis=0), np.maximum(np.ptp(points, axis=0), 1e-300)
    scale = min((_WIDTH - 2 * _MARGIN) / sides[0], (_MOST - 2 * _MARGIN) / sides[1])
    height = max(scale * float(sides[1]) + 2 * _MARGIN, _LEAST)
    x, y = (scale * (points - low)).T
    places = " ".join(
        f"{a + _MARGIN:.1f},{height - _MARGIN - b:.1f}" for a, b in zip(x.tolist(), y.tolist(), strict=True)
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{_WIDTH:.0f}" height="{height:.0f}" role="img" '
        f'aria-label="polyline of {len(points)} points">'
        f'<polyline points="{places}" fill="none" stroke="#0072B2" stroke-width="2"/></svg>'
    )


class Oriented(NamedTuple):
    """An interface, and whether it had to be reversed."""

    interface: Interface
    flipped: bool


def oriented_like(observed: Interface, reference: Interface) -> Oriented:
    """Return `observed` in the direction of `reference`, and whether it had to be reversed."""
    flipped = observed.runs_against(reference)
    return Oriented(observed.reversed() if flipped else observed, flipped)


def inside_polygon(
    points: Float[np.ndarray, "*point 2"], polygon: Float[np.ndarray, "corner 2"]
) -> Bool[np.ndarray, "*point"]:
    """Return which points a polygon contains, by the number of its sides to the right of each; any shape (..., 2)."""
    inside = np.zeros(points.shape[:-1], dtype=bool)
    x, y = points[..., 0], points[..., 1]
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if a[1] != b[1]:
            spans = (a[1] > y) != (b[1] > y)
            inside ^= spans & (x < a[0] + (y - a[1]) * (b[0] - a[0]) / (b[1] - a[1]))
    return inside


def _cross(a: Float[np.ndarray, "*#pair 2"], b: Float[np.ndarray, "*#pair 2"]) -> Float[np.ndarray, "..."]:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _meeting(
    starts: Float[np.ndarray, "cell 2"], ends: Float[np.ndarray, "cell 2"], slack: float, *, closed: bool
) -> Iterator[tuple[int, int]]:
    """Yield the pairs of segments, except neighbours, that share a point: each crosses the line of the other.

    Only pairs with overlapping bounding boxes are examined; they are found along the longer side of the polyline.
    """
    low, high, number = np.minimum(starts, ends) - slack, np.maximum(starts, ends), len(starts)
    along = int(np.argmax(np.ptp(starts, axis=0)))
    order = np.argsort(low[:, along], kind="stable")
    partners = np.searchsorted(low[order, along], high[order, along], side="right") - np.arange(number) - 1
    pairs = np.concatenate([[0], np.cumsum(partners)])
    begin = 0
    while begin < number:
        end = max(int(np.searchsorted(pairs, pairs[begin] + _PAIRS, side="right")) - 1, begin + 1)
        one = np.repeat(np.arange(begin, end), partners[begin:end])
        two = one + 1 + np.arange(pairs[begin], pairs[end]) - pairs[one]
        i, j = np.sort([order[one], order[two]], axis=0)
        near = (j > i + 1) & ~(closed & (i == 0) & (j == number - 1))
        near &= (low[i] <= high[j]).all(axis=1) & (low[j] <= high[i]).all(axis=1)
        i, j = i[near], j[near]
        a, b, p, q = starts[i], ends[i], starts[j], ends[j]
        hit = _straddle(a, b, p, q, slack) & _straddle(p, q, a, b, slack)
        yield from zip(i[hit].tolist(), j[hit].tolist(), strict=True)
        begin = end


def _straddle(a: Corners, b: Corners, p: Corners, q: Corners, slack: float) -> Bool[np.ndarray, " other"]:
    """Return whether p and q lie on different sides of the line through a and b, or on it."""
    d = (b - a) / np.linalg.norm(b - a, axis=-1, keepdims=True)
    one, two = _cross(d, p - a), _cross(d, q - a)
    return np.asarray((np.minimum(one, two) <= slack) & (np.maximum(one, two) >= -slack))


def _shared_point(a: Point, b: Point, p: Point, q: Point) -> Point:
    """Return a common point of two segments that meet; if they overlap, the middle of the overlap."""
    d, e = b - a, q - p
    denominator = float(_cross(d, e))
    if abs(denominator) > 1e-12 * math.hypot(*d) * math.hypot(*e):
        return np.asarray(a + np.clip(_cross(p - a, e) / denominator, 0.0, 1.0) * d)
    shares = np.clip([(p - a) @ d / (d @ d), (q - a) @ d / (d @ d)], 0.0, 1.0)
    return np.asarray(a + shares.mean() * d)
