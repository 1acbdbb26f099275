"""The interface: what a forward model returns and an experiment observes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from strandline.errors import InvalidInterface

__all__ = ["Interface", "Observation"]


@dataclass(frozen=True, eq=False)
class Interface:
    """A polyline in the plane or a triangulated surface in space; lengths in mm.

    Args:
        points: node coordinates (point, xyz).
        cells: node numbers of the segments (cell, 2) or triangles (cell, 3).

    Segments run along the interface with the solid on one constant side; the order of the two nodes fixes the normal.

    Raises:
        InvalidInterface: fewer points than one cell needs, a value that is not finite, or a cell of no extent.
    """

    points: Float[np.ndarray, "point xyz"]
    cells: Int[np.ndarray, "cell corner"]

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
                f"point {where} of the interface is not finite",
                value=self.points[where].tolist(),
                expected="finite coordinates in mm",
                remedy="Remove or correct the point.",
            )
        if self.dim == 2 and (self.lengths == 0).any():
            where = int(np.argmax(self.lengths == 0))
            raise InvalidInterface(
                f"segment {where} of the interface has no length",
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
        """Number of coordinates, 2 or 3."""
        return int(self.points.shape[1])

    @property
    def closed(self) -> bool:
        """Whether a polyline returns to its first point."""
        return bool(self.cells[-1, -1] == self.cells[0, 0])

    @property
    def starts(self) -> Float[np.ndarray, "cell 2"]:
        """First node of each segment."""
        return np.asarray(self.points[self.cells[:, 0]])

    @property
    def ends(self) -> Float[np.ndarray, "cell 2"]:
        """Second node of each segment."""
        return np.asarray(self.points[self.cells[:, 1]])

    @property
    def lengths(self) -> Float[np.ndarray, " cell"]:
        """Segment lengths, mm."""
        return np.asarray(np.linalg.norm(self.ends - self.starts, axis=1))

    @property
    def centres(self) -> Float[np.ndarray, "cell xyz"]:
        """Cell centres, mm."""
        return np.asarray(self.points[self.cells].mean(axis=1))

    @property
    def normals(self) -> Float[np.ndarray, "cell 2"]:
        """Segment normals times length, mm: the tangent turned by +90°."""
        tangent = self.ends - self.starts
        return np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)

    def reversed(self) -> "Interface":
        """Return the same polyline run through from its other end."""
        return Interface.polyline(self.points[::-1], closed=self.closed)

    def resampled(self, number: int) -> "Interface":
        """Return `number` points equally spaced by arclength along an open polyline."""
        arclength = np.concatenate([[0.0], np.cumsum(self.lengths)])
        wanted = np.linspace(0.0, arclength[-1], number)
        columns = [np.interp(wanted, arclength, self.points[:, k]) for k in range(self.dim)]
        return Interface.polyline(np.stack(columns, axis=1))

    def runs_against(self, other: "Interface") -> bool:
        """Tell whether `other`, roughly the same polyline, is run through from its other end.

        Open polylines are compared by their chords, closed ones by the sign of the area they enclose.
        """
        if self.closed and other.closed:
            return bool(self._signed_area() * other._signed_area() < 0)
        chords = [i.points[i.cells[-1, -1]] - i.points[i.cells[0, 0]] for i in (self, other)]
        return bool(chords[0] @ chords[1] < 0)

    def require_simple(self) -> None:
        """Refuse a polyline that crosses or touches itself.

        Raises:
            InvalidInterface: with the two segments and the place.
        """
        crossing = self._first_crossing()
        if crossing is not None:
            i, j, place = crossing
            raise InvalidInterface(
                f"the interface crosses itself: segments {i} and {j}",
                value=f"({place[0]:.6g}, {place[1]:.6g}) mm",
                expected="a polyline without crossings, its points in order along the interface",
                remedy="Sort the points along the interface or remove the loop.",
            )

    def _signed_area(self) -> float:
        a, b = self.starts, self.ends
        return float(0.5 * np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))

    def _first_crossing(self) -> tuple[int, int, Float[np.ndarray, "2"]] | None:
        """Return (i, j, place) of the first pair of segments, not neighbours, that share a point."""
        a, d = self.starts, self.ends - self.starts
        number = len(a)
        i, j = np.triu_indices(number, k=2)
        if self.closed:
            i, j = i[(i > 0) | (j < number - 1)], j[(i > 0) | (j < number - 1)]
        gap = a[j] - a[i]
        denominator = _cross(d[i], d[j])
        with np.errstate(divide="ignore", invalid="ignore"):
            s, t = _cross(gap, d[j]) / denominator, _cross(gap, d[i]) / denominator
        hit = np.flatnonzero((s >= 0) & (s <= 1) & (t >= 0) & (t <= 1))
        if hit.size == 0:
            return None
        k = hit[0]
        return int(i[k]), int(j[k]), a[i[k]] + s[k] * d[i[k]]


@dataclass(frozen=True, eq=False)
class Observation:
    """An observed interface and the variance σ_N² of the noise that the discrepancy is measured against.

    Args:
        interface: the observed interface, mm.
        noise_variance: σ_N², in the unit of the discrepancy d².
        condition: the experimental condition or time it belongs to.
    """

    interface: Interface
    noise_variance: float
    condition: str = ""


def _cross(a: Float[np.ndarray, "pair 2"], b: Float[np.ndarray, "pair 2"]) -> Float[np.ndarray, " pair"]:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
