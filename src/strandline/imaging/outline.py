"""An edge with noise → the smooth outline of a body on a floor, with the errors that are left.

The outline is the marked path plus an offset along its normals: a Gaussian process (Matérn 5/2; Rasmussen and Williams,
Gaussian Processes for Machine Learning, 2006, ch. 2). It changes from one marked point to the next, for each is off by
itself, and its standard deviation is at least that of the edge: in so much noise smaller offsets would not be seen.
Between the edge's last points and the floor it follows the marked path, with an error that grows.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize_scalar
from scipy.spatial import cKDTree

from strandline.foundations import InvalidInput, unfit

PerPoint = Float[np.ndarray, " point"]
Points = Float[np.ndarray, "point 2"]
NODES = 400
"""Nodes of the outline."""
MOST = 600
"""Most points of the edge that are used as they are: of more, neighbours are averaged."""
LONGEST_GAP = 0.05
"""Greatest height of an end of the path above the floor, as a share of the path's length."""
BACK = 20
"""Nodes over which the direction of an end is taken."""
ROUNDED = 7
"""Decimals of the coordinates in mm, so that computers that round differently make the same model."""
_SUBDIVIDED = 10
_MOST_OFF = 100.0
"""Greatest offset from the marked path that is thought of, in standard deviations of the edge."""


@dataclass(frozen=True, eq=False)
class Outlined:
    """A smooth outline and its errors.

    Args:
        points: Points (x, y) from one foot to the other, on the floor y = 0 at both ends, mm, shape (point, 2).
        sd: Standard deviation of a point along its normal, mm: what is left of the edge's errors.
        length: Correlation length of these errors, mm.
    """

    points: Points
    sd: float
    length: float


def outline_of(edge: Points, path: Float[np.ndarray, "click 2"], *, sd: float, length: float) -> Outlined:
    """Return the outline of a body on the floor y = 0 from its edge.

    Args:
        edge: Points of the edge in order, mm, shape (point, 2).
        path: Marked path from foot to foot in the same direction, mm, shape (click, 2).
        sd: Standard deviation of a point of the edge along its normal, mm.
        length: Correlation length of these errors, mm; 0 for independent points.

    Raises:
        InvalidInput: An end of the path is far above the floor.
    """
    base = _Base(path)
    places, offsets = base.located(edge)
    spacing = float(np.median(np.linalg.norm(np.diff(edge, axis=0), axis=1)))
    level = sd**2 * max(spacing, 2 * length)
    places, offsets, spacing = _averaged(places, offsets, spacing)
    reach = float(np.median(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    at = np.linspace(0.0, base.arc[-1], NODES)
    mean, covariance = _process(places, offsets, level / spacing, at, reach=reach, least=sd)
    line = base.spline(at) + mean[:, None] * base.normals(at)
    points, kept = _on_floor(line)
    seen = (at[kept] >= places.min()) & (at[kept] <= places.max())
    left = math.sqrt(float(np.median(np.diag(covariance)[kept][seen])))
    return Outlined(np.round(points, ROUNDED), left, level / (2 * left**2))


class _Base:
    """A cubic spline through the marked path, by its arc length."""

    def __init__(self, path: Float[np.ndarray, "click 2"]) -> None:
        chord = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
        fine = CubicSpline(chord, path)(np.linspace(0.0, chord[-1], 40 * len(path)))
        self.arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(fine, axis=0), axis=1))])
        self.spline = CubicSpline(self.arc, fine)

    def normals(self, at: Float[np.ndarray, " place"]) -> Float[np.ndarray, "place 2"]:
        """Return its unit normals, on the left of the path when y points up."""
        tangents = self.spline(at, 1)
        tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
        return np.stack([-tangents[:, 1], tangents[:, 0]], axis=1)

    def located(self, edge: Points) -> tuple[PerPoint, PerPoint]:
        """Return arc length and offset along the normal of the base's nearest points, in order of arc length."""
        at = np.linspace(0.0, self.arc[-1], _SUBDIVIDED * len(edge))
        nearest = cKDTree(self.spline(at)).query(edge)[1]
        found = at[nearest]
        for _ in range(3):  # Newton steps to the foot of the perpendicular
            away, slope = edge - self.spline(found), self.spline(found, 1)
            found = np.clip(found + (away * slope).sum(axis=1) / (slope**2).sum(axis=1), 0.0, self.arc[-1])
        offsets = ((edge - self.spline(found)) * self.normals(found)).sum(axis=1)
        order = np.argsort(found, kind="stable")
        return found[order], offsets[order]


def _process(
    places: PerPoint, offsets: PerPoint, variance: float, at: Float[np.ndarray, " node"], *, reach: float, least: float
) -> tuple[Float[np.ndarray, " node"], Float[np.ndarray, "node node"]]:
    """Return mean and covariance, at the nodes, of the offsets as a Gaussian process; lengths in mm.

    `variance` is that of the offsets' noise. The process changes over the length `reach`; its standard deviation is
    `least`, or a larger one if the offsets are more probable then.
    """
    noise = variance * np.eye(len(places))

    def loss(log_amplitude: float) -> float:
        """Return minus the log evidence."""
        K = _matern(places, places, math.exp(log_amplitude), reach) + noise
        factor = cho_factor(K, lower=True, overwrite_a=True)
        return float(0.5 * offsets @ cho_solve(factor, offsets) + np.log(np.diag(factor[0])).sum())

    found = minimize_scalar(loss, bounds=(math.log(least), math.log(_MOST_OFF * least)), method="bounded")
    amplitude = math.exp(found.x)
    across = _matern(at, places, amplitude, reach)
    factor = cho_factor(_matern(places, places, amplitude, reach) + noise, lower=True)
    mean = across @ cho_solve(factor, offsets)
    return mean, _matern(at, at, amplitude, reach) - across @ cho_solve(factor, across.T)


def _matern(
    a: Float[np.ndarray, " a"], b: Float[np.ndarray, " b"], amplitude: float, reach: float
) -> Float[np.ndarray, "a b"]:
    r = math.sqrt(5.0) * np.abs(a[:, None] - b) / reach
    return np.asarray(amplitude**2 * (1 + r + r**2 / 3) * np.exp(-r))


def _averaged(
    places: PerPoint, offsets: PerPoint, spacing: float
) -> tuple[Float[np.ndarray, " group"], Float[np.ndarray, " group"], float]:
    """Return means of groups of neighbours, few enough for a dense matrix, and the spacing of the groups."""
    size = -(-len(places) // MOST)
    if size == 1:
        return places, offsets, spacing
    number = len(places) // size
    grouped = (one[: number * size].reshape(number, size).mean(axis=1) for one in (places, offsets))
    return *grouped, size * spacing


def _on_floor(line: Points) -> tuple[Float[np.ndarray, "kept 2"], slice]:
    """Return the part of a line above the floor with a foot at each end, and which of its points are in it."""
    above = line[:, 1] > 0
    if not above.any():
        raise _refused("an outline below y = 0")
    first, last = int(np.argmax(above)), len(line) - int(np.argmax(above[::-1]))
    inner = line[first:last]
    if len(inner) <= BACK:
        raise _refused("an outline that is below y = 0 nearly everywhere")
    length = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
    out = inner.copy()
    for end, step in ((0, 1), (-1, -1)):
        outside = first - 1 if end == 0 else last
        if 0 <= outside < len(line):  # the line crosses the floor between these two points
            towards = line[outside] - inner[end]
        else:
            towards = inner[end] - inner[end + BACK * step]  # on as before, but down by 45° at least
            towards[1] = min(towards[1], -abs(towards[0]))
        if inner[end, 1] > LONGEST_GAP * length:
            raise _refused(f"an end of the outline {inner[end, 1]:.3g} mm above it")
        out[end] = inner[end] - towards * (inner[end, 1] / towards[1])
        out[end, 1] = 0.0
    return out, slice(first, last)


def _refused(found: str) -> InvalidInput:
    remedy = "Mark the path down to both feet, and check `frame.origin`, which is a point of the floor."
    return unfit("undeformed outline in the picture", found, "a path from the floor y = 0 to the floor", remedy)
