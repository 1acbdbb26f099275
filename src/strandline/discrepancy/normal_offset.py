"""Signed distances from the observed points to the simulated interface, whitened by their errors if these are known.

Of many observed points, a few neighbouring ones are as far from the simulated interface as one place on their course,
each but for its own small distance e from that course: the signed distance varies slowly along the observed interface.
The course is a parabola through the points and their neighbours: the distances of points on a curved piece to an
interface that is curved alike are all the same.

Shift, rotation, scale and offset of the observation are estimated first. Residuals r are linear in these global errors
g only as long as a shift t is small: t²/(2R) is the error for radius of curvature R. So g is estimated for each
simulated interface, the interface follows the observation by g, and the residuals r' of the moved one take the place
of r. With r' = e + B (g_true - g), q = r' + B g = e + B g_true is what the residuals would be if they were linear. This
holds for any g near the most probable one: two steps with some of the observed points lead there. An offset along the
normals is linear however large it is: no interface follows it.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from strandline.discrepancy.many_distances import FEWEST, signed_sums
from strandline.discrepancy.nearest import closest_points
from strandline.discrepancy.protocol import ManyPoints, Offsets, Snapshot, Values, require_alike
from strandline.interface import Interface, as_complex

FEWEST_AVERAGED = 6
"""Fewest points in a mean: with fewer, little would be saved. Means drop what the slopes of r within a place tell, and
with many places of few points this moved a posterior by 0.27 standard deviations."""
TURN = 0.35  # largest angle by which the course may turn along the points of one mean, radians
GAP = 10.0  # distance of neighbouring points beyond which they are not averaged, in medians
BESIDE = 2  # places on each side whose points help to find the course; near an end more on the other side
MOST_GAPS = 0.02  # share of such gaps beyond which the points are not in order along a curve
Sums = tuple[Values, Float[np.ndarray, "run error"]]  # rᵀ D⁻¹ r and Bᵀ D⁻¹ r of each run
ROUGH = 64  # places along an observed polyline that estimate g, about
BEYOND = 0.05  # share of its length by which an open polyline goes on straight at each end
PLACES = 200  # places along an observed polyline whose distances stand for those of all its points, about


@dataclass(frozen=True, eq=False)
class LocalMeans:
    """Places that stand for some neighbouring points each, `first` of all the one with this index.

    `normals` are those of the course at the places, to the left of its direction, `off` is the distance of each point
    from its course, along the normal, mm; its mean over the points of a place is 0.
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
    """Return about `number` places, more where points turn sharply; None if these are few, or not along a curve."""
    return _kept(points.tobytes(), number)


@lru_cache(maxsize=32)
def _kept(content: bytes, number: int) -> LocalMeans | None:
    points = np.frombuffer(content).reshape(-1, 2)
    size = len(points) // number
    if size < FEWEST_AVERAGED:
        return None
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    gaps = steps > GAP * np.median(steps)
    if gaps.mean() > MOST_GAPS:
        return None
    after = np.flatnonzero(gaps) + 1
    while size >= FEWEST_AVERAGED:
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
        bend, slope, _ = np.polyfit(u, v, 2) if len(around) >= 4 * FEWEST_AVERAGED else (0.0, 0.0, 0.0)
        u, v = (own - middle) @ along, (own - middle) @ normal
        if abs(2 * bend) * np.ptp(u) > TURN:
            return None
        level = float(np.mean(v - bend * u**2))
        places[k], normals[k] = middle + level * normal, normal
        off[begin:end] = v - (level + slope * u + bend * u**2)
    return LocalMeans(places, normals, first, off)


@dataclass(frozen=True)
class NormalOffset:
    """d² = Σ r_i², mm², with r_i the signed distance from observed point i to the simulated interface.

    With stated errors of the observed points, `WhitenedOffset` takes its place. Parts of the simulated interface that
    were not observed cost nothing; an open one goes on straight beyond its ends by a twentieth of its length.
    """

    unit: ClassVar[str] = "mm²"

    def __call__(self, simulated: Interface, observed: Interface) -> float:
        """Return d²."""
        require_alike(simulated, observed)
        return float((signed_distances(observed.points, simulated) ** 2).sum())

    def many(self, points: ManyPoints, template: Interface, observed: Interface) -> Values:
        """Return d² of interfaces of the same cells."""
        require_alike(template, observed)
        seen = observed.points
        return weighted_sums(seen, points, template, np.ones(len(seen)), np.empty((len(seen), 0)))[0]

    def of_offsets(self, offsets: Offsets, observed: Interface, nodes: int) -> Values:
        return np.asarray((offsets**2).sum(axis=1))

    def terms(self, observed: Interface) -> int:
        """Return the number of observed points."""
        return len(observed.points)


def signed_distances(points: Float[np.ndarray, "point xyz"], interface: Interface) -> Float[np.ndarray, " point"]:
    """Return the distances to the closest points of `interface`, mm; negative on the side away from its normals.

    An open polyline goes on straight beyond its ends, by a twentieth of its length: a point that is off along the
    polyline, not across it, is not charged there.
    """
    return _signed(points, Interface(extended(interface.points[None], interface)[0], interface.cells))


def _signed(points: Float[np.ndarray, "point xyz"], interface: Interface) -> Float[np.ndarray, " point"]:
    found = closest_points(points, interface, once=True)
    corners = interface.points[interface.cells[found.cells, 0]]
    side = ((points - corners) * interface.normals[found.cells]).sum(axis=1)
    return np.asarray(np.copysign(np.sqrt(found.squares), side))


def weighted_sums(
    seen: Float[np.ndarray, "seen xyz"],
    points: ManyPoints,
    template: Interface,
    weights: Float[np.ndarray, " seen"],
    features: Float[np.ndarray, "seen feature"],
    *,
    rough: bool = False,
    longer: bool = False,
) -> Sums:
    """Return Σ w r² and Σ f r over the signed distances r of the observed points, for each simulated interface.

    Means of neighbouring points stand for many points of a polyline. With `rough`, very few places along a polyline
    stand for all points; with `longer`, the interfaces are `extended` already.
    """
    points = points if longer else extended(points, template)
    if template.dim == 2 and len(points) >= FEWEST:
        found = _by_places(seen, points, template, weights, features, ROUGH if rough else PLACES)
        if found is None:
            found = signed_sums(seen[None], points, template.cells, weights[None], features)
        if found is not None:
            return found
    each = [_signed(seen, Interface(row, template.cells)) for row in points]
    r = np.array(each, float).reshape(len(points), len(seen))
    return r**2 @ weights, r @ features


def _by_places(
    seen: Float[np.ndarray, "seen 2"],
    points: Float[np.ndarray, "run point 2"],
    template: Interface,
    weights: Float[np.ndarray, " seen"],
    features: Float[np.ndarray, "seen feature"],
    number: int,
) -> Sums | None:
    """Return the sums over many points from the distances of a few places, as r_i = r of its place + e_i."""
    means = local_means(seen, number)
    if means is None:
        return None
    off = _side(means, Snapshot.of(template)) * means.off
    cross = means.of_places(weights * off)
    columns = np.column_stack([means.of_places(features), cross])
    found = signed_sums(means.places[None], points, template.cells, means.of_places(weights)[None], columns)
    if found is None:
        return None
    squares, products = found
    return squares + 2 * products[:, -1] + float(weights @ off**2), products[:, :-1] + off @ features


def extended(points: Float[np.ndarray, "run node xyz"], template: Interface) -> Float[np.ndarray, "run node xyz"]:
    """Return interfaces with the cells of `template`; the end segments of open polylines are a twentieth longer."""
    if template.dim == 3 or template.closed:
        return points
    cells, places = template.cells, as_complex(points)
    whole = np.abs(places[:, cells[:, 1]] - places[:, cells[:, 0]]).sum(axis=1)
    out = points.copy()
    for end, inner in (cells[0], cells[-1, ::-1]):
        step = points[:, end] - points[:, inner]
        out[:, end] += (BEYOND * whole / np.linalg.norm(step, axis=1))[:, None] * step
    return out


@lru_cache(maxsize=64)
def _side(means: LocalMeans, snapshot: Snapshot) -> float:
    return means.side(snapshot.interface)
