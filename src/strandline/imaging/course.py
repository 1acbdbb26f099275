"""The course of a path in a picture: points one pixel apart, their normals, and how it is smoothed.

Lengths are in units of the smaller side of a pixel, with x to the right and y down: `Picture.stretch` turns pixel
coordinates into them, so that normals and distances are right where pixels are not square.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

_NEARER, _SLACK = 0.85, 1.0
"""A place on a normal belongs to another part of the path if that is nearer than this share of its distance, minus
this slack."""


@dataclass(frozen=True, eq=False)
class SmoothPath:
    """A smooth path, its points about one pixel apart.

    Args:
        points: Points (x, y), shape (point, 2).
        closed: Whether the last point is followed by the first.
    """

    points: Float[np.ndarray, "point 2"]
    closed: bool

    @cached_property
    def arc(self) -> Float[np.ndarray, " point"]:
        """Arc length of each point from the first one."""
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.points, axis=0), axis=1))])

    @cached_property
    def tangents(self) -> Float[np.ndarray, "point 2"]:
        """Unit tangents: those of the chord between the two neighbours."""
        chord = _slope(self.points, self.closed)
        return np.asarray(chord / np.linalg.norm(chord, axis=1, keepdims=True))

    @property
    def normals(self) -> Float[np.ndarray, "point 2"]:
        """Unit normals to the left of the path as the picture is seen: those of `Interface` once y points up."""
        return np.stack([self.tangents[:, 1], -self.tangents[:, 0]], axis=1)

    @cached_property
    def curvatures(self) -> Float[np.ndarray, " point"]:
        """Curvature 1/R, above 0 where the centre of curvature is on the right as the picture is seen."""
        turn = _slope(self.tangents, self.closed)
        length = np.linalg.norm(_slope(self.points, self.closed), axis=1)
        return np.asarray((self.tangents[:, 0] * turn[:, 1] - self.tangents[:, 1] * turn[:, 0]) / length)

    def reversed(self) -> "SmoothPath":
        """Return the same path in the other direction."""
        return SmoothPath(self.points[::-1].copy(), self.closed)

    def at(self, offsets: Float[np.ndarray, "point ..."]) -> Float[np.ndarray, "..."]:
        """Return places at these distances along the normals, shape (point, ..., 2)."""
        shape = (len(self.points), *([1] * (offsets.ndim - 1)), 2)
        return np.asarray(self.points.reshape(shape) + offsets[..., None] * self.normals.reshape(shape))

    def own(self, offsets: Float[np.ndarray, " place"]) -> Bool[np.ndarray, "point place"]:
        """Return which places along the normals are not clearly nearer to another part of the path.

        Beyond the others normals have crossed: inside a narrow bend, or across a thin part.
        """
        bound = np.maximum(_NEARER * np.abs(offsets) - _SLACK, 0.0)
        places = self.at(np.broadcast_to(offsets, (len(self.points), len(offsets))))
        out = np.ones(places.shape[:2], dtype=bool)
        far = bound > 0
        near, _ = cKDTree(self.points).query(places[:, far], distance_upper_bound=float(bound.max()) + 1.0)
        out[:, far] = near >= bound[far]
        return out


def course_through(points: Float[np.ndarray, "point 2"], *, closed: bool, sigma: float) -> SmoothPath:
    """Return the smooth path through points that may be few and far apart, e.g. clicks.

    Between two of them both coordinates are monotone: the path does not bulge.

    Args:
        points: Points (x, y), at least two that differ; consecutive equal ones count once.
        closed: Whether the path returns to its first point.
        sigma: Standard deviation of the Gaussian along the path that smooths it.
    """
    around = np.concatenate([points[-3:], points, points[:3]]) if closed else points
    steps = np.linalg.norm(np.diff(around, axis=0), axis=1)
    keep = np.concatenate([[True], steps > 0])
    around = around[keep]
    chord = np.concatenate([[0.0], np.cumsum(steps[steps > 0])])
    if len(around) == 2:
        return _equally_spaced(around, closed=False)
    curve = PchipInterpolator(chord, around)
    first, last = (chord[3], chord[-3]) if closed else (chord[0], chord[-1])
    fine = curve(np.linspace(first, last, max(4 * int(last - first), 64) + 1))
    return smoothed(fine[:-1] if closed else fine, closed=closed, sigma=sigma)


def smoothed(points: Float[np.ndarray, "point 2"], *, closed: bool, sigma: float) -> SmoothPath:
    """Return the course along points, convolved with a Gaussian of this standard deviation along it.

    The ends of an open path stay in place.
    """
    course = _equally_spaced(points, closed=closed)
    points = _convolved(course.points, sigma, closed=closed)
    return _equally_spaced(points, closed=closed)


def _equally_spaced(points: Float[np.ndarray, "point 2"], *, closed: bool) -> SmoothPath:
    """Return points one unit apart, as nearly as fits the length."""
    path = np.concatenate([points, points[:1]]) if closed else points
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    places = np.linspace(0.0, arc[-1], max(round(float(arc[-1])), 3) + 1)
    places = places[:-1] if closed else places
    return SmoothPath(np.stack([np.interp(places, arc, path[:, k]) for k in (0, 1)], axis=1), closed)


def _convolved(points: Float[np.ndarray, "point 2"], sigma: float, *, closed: bool) -> Float[np.ndarray, "point 2"]:
    if closed:
        return np.asarray(gaussian_filter1d(points, sigma, axis=0, mode="wrap"))
    pad = min(len(points) - 1, int(4 * sigma) + 1)  # reflected through the end points, which therefore stay
    before, after = 2 * points[0] - points[pad:0:-1], 2 * points[-1] - points[-2 : -pad - 2 : -1]
    return np.asarray(gaussian_filter1d(np.concatenate([before, points, after]), sigma, axis=0)[pad:-pad])


def _slope(values: Float[np.ndarray, "point 2"], closed: bool) -> Float[np.ndarray, "point 2"]:
    """Return half the difference between the two neighbours of each point, at the ends that to one."""
    if closed:
        return np.asarray(0.5 * (np.roll(values, -1, axis=0) - np.roll(values, 1, axis=0)))
    return np.asarray(np.gradient(values, axis=0))
