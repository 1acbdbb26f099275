"""A long row of observed points, by the means of neighbouring ones: sums over them from a fraction of the distances.

The signed distance to a simulated interface varies slowly along the observed one. So a few neighbouring points are as
far away as one place on their course, each but for its own small distance e from that course. The course is a parabola
through the points and their neighbours: the distances of points on a curved piece to an interface that is curved alike
are all the same.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from strandline.discrepancy.search.nearest import closest_points
from strandline.interface import Interface

__all__ = ["LocalMeans", "local_means"]

FEWEST = 6
"""Fewest points in a mean: with fewer, little would be saved. Means drop what the slopes of r within a place tell, and
with many places of few points this moved a posterior by 0.27 standard deviations."""
TURN = 0.35
"""Largest angle by which the course may turn along the points of one mean, radians."""
GAP = 10.0
"""Distance of neighbouring points beyond which they are not averaged, in medians."""
BESIDE = 2
"""Places on each side whose points help to find the course; near an end more on the other side."""
MOST_GAPS = 0.02
"""Share of such gaps beyond which the points are not in order along a curve."""


@dataclass(frozen=True, eq=False)
class LocalMeans:
    """Places that stand for some neighbouring points each.

    Args:
        places: The places, shape (place, 2), mm.
        normals: Normals of the course at the places, to the left of its direction, shape (place, 2).
        first: Index of the first point of each place.
        off: Distance of each point from its course, along the normal, mm; its mean over the points of a place is 0.
    """

    places: Float[np.ndarray, "place 2"]
    normals: Float[np.ndarray, "place 2"]
    first: Int[np.ndarray, " place"]
    off: Float[np.ndarray, " point"]

    def side(self, template: Interface) -> float:
        """Return 1 if the normals are on the side of a simulated interface's, -1 if they are on the other side."""
        nearest = closest_points(self.places, template).cells
        return 1.0 if float((self.normals * template.normals[nearest]).sum()) >= 0 else -1.0

    def of_places(self, values: Float[np.ndarray, "point *more"]) -> Float[np.ndarray, "place *more"]:
        """Return the sums of values over the points of each place."""
        return np.asarray(np.add.reduceat(values, self.first, axis=0))


def local_means(points: Float[np.ndarray, "point 2"], number: int) -> LocalMeans | None:
    """Return about `number` places, more where the points turn sharply.

    None if the points are few, or not in order along a curve.
    """
    return _kept(points.tobytes(), number)


@lru_cache(maxsize=32)
def _kept(content: bytes, number: int) -> LocalMeans | None:
    points = np.frombuffer(content).reshape(-1, 2)
    size = len(points) // number
    if size < FEWEST:
        return None
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    gaps = steps > GAP * np.median(steps)
    if gaps.mean() > MOST_GAPS:
        return None
    after = np.flatnonzero(gaps) + 1
    while size >= FEWEST:
        found = _of_parts(points, np.unique(np.concatenate([np.arange(0, len(points), size), after])), after)
        if found is not None:
            return found
        size //= 2
    return None


def _of_parts(
    points: Float[np.ndarray, "point 2"], first: Int[np.ndarray, " place"], after: Int[np.ndarray, " gap"]
) -> LocalMeans | None:
    """Fit a parabola to each part and its neighbours, not beyond the gaps; None if one turns too far."""
    piece = np.searchsorted(after, first, side="right")
    last = np.append(first[1:], len(points))
    places, normals, off = np.empty((len(first), 2)), np.empty((len(first), 2)), np.empty(len(points))
    for k, (begin, end) in enumerate(zip(first, last, strict=True)):
        begins, ends = np.searchsorted(piece, piece[k]), np.searchsorted(piece, piece[k], side="right")
        low = max(begins, min(k - BESIDE, ends - 2 * BESIDE - 1))
        around = points[first[low] : last[min(low + 2 * BESIDE, ends - 1)]]
        own = points[begin:end]
        middle = own.mean(axis=0)
        chord = around[-len(around) // 3 :].mean(axis=0) - around[: len(around) // 3 + 1].mean(axis=0)
        along = chord / np.linalg.norm(chord)
        normal = np.array([-along[1], along[0]])
        u, v = (around - middle) @ along, (around - middle) @ normal
        bend, slope, _ = np.polyfit(u, v, 2) if len(around) >= 4 * FEWEST else (0.0, 0.0, 0.0)
        u, v = (own - middle) @ along, (own - middle) @ normal
        if abs(2 * bend) * np.ptp(u) > TURN:
            return None
        level = float(np.mean(v - bend * u**2))
        places[k], normals[k] = middle + level * normal, normal
        off[begin:end] = v - (level + slope * u + bend * u**2)
    return LocalMeans(places, normals, first, off)
