"""Errors of the points of an outline, from several contours of it: repeated pictures of one state.

All contours are compared with the smoothed longest one, point by point along it. What they have in common, the true
outline minus the smoothed one, goes with their mean. What is left of n contours has (n-1)/n of the variance of their
errors. From each contour's offsets the shift, rotation, scale and offset that explain most of them are removed; what
these take from the local errors is known (`restored`), as is what local errors add to their spread.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.special import gammaincinv

from strandline.discrepancy.contours import Correlated, autocovariance, path_of, require_contours, restored, smoothed
from strandline.discrepancy.nearest import closest_points
from strandline.discrepancy.normal_offset import signed_distances
from strandline.foundations import InvalidInput, unfit
from strandline.interface import Interface, PointErrors, normals_at, oriented_like

PerPlace = Float[np.ndarray, " place"]
PARTS = ("shift_x", "shift_y", "rotation", "scale", "offset")
"""Errors that all points of a contour share: mm, mm, degrees, a share, mm."""
PIECES = 16  # the outline that all are compared with is smoothed over a piece of one in so many
ENDS = 0.05  # share of an open outline that is left out at each end
CERTAIN = 0.95  # probability with which local errors alone would not spread the common errors as much
FEW = 5  # number of contours below which the spread of the common errors is a guess
_WEAKEST, _NONE = 0.1, 0.02
"""Effects of a combination of common errors, relative to the strongest one, below which it is not looked for, and below
which it does nothing to the offsets."""
_GAP = 5.0  # largest gap in a contour, in steps, after its shift and rotation were undone in two passes
_FEWEST_PLACES = 20


@dataclass(frozen=True, eq=False)
class Repeats:
    """What several contours of one state show of the errors of their points.

    Args:
        errors: Standard deviations and correlation length; a common error is 0 if the local ones explain its spread.
        spacing: Distance of the places along the outline at which the contours were compared, mm.
        places: Number of these places.
        parts: Shift in x and y, rotation, scale and offset of each contour against the mean, in the units of `PARTS`.
        notes: Sentences on what these numbers leave out.
    """

    errors: PointErrors
    spacing: float
    places: int
    parts: Float[np.ndarray, "contour part"]
    notes: tuple[str, ...]


def errors_from_repeats(contours: Sequence[Interface]) -> Repeats:
    """Return the errors of the points of contours that show one state, each from its own picture.

    Args:
        contours: Two contours or more, of at least 30 points; neither points nor directions need to correspond.

    Raises:
        InvalidInput: Fewer contours or points, open and closed contours, sizes ten times apart, contours that overlap
            too little or have gaps, or that agree exactly.
    """
    if len(contours) < 2:
        remedy = "For a single contour, take errors_from_roughness."
        raise unfit("number of contours of one state", len(contours), "at least 2; better 5 or more", remedy)
    require_contours(contours)
    longest = max(contours, key=lambda one: float(one.lengths.sum()))
    alike = [oriented_like(one, longest).interface for one in contours]
    frame = _frame(longest, alike)
    parts = np.zeros((len(alike), len(PARTS)))
    for most in (np.inf, np.inf, _GAP * frame.step):
        back = [_moved_back(one, part, frame.middle) for one, part in zip(alike, parts, strict=True)]
        offsets = np.stack([frame.offsets(one, most) for one in back]) - parts[:, -1:]
        offsets = offsets - offsets.mean(axis=0)
        parts = parts + offsets @ frame.estimate.T
    local = _local(offsets - (offsets @ frame.basis) @ frame.basis.T, frame)
    errors = _errors(local, parts, frame)
    return Repeats(errors, frame.step, len(frame.places), parts, tuple(_notes(local, len(alike))))


@dataclass(frozen=True, eq=False)
class _Frame:
    """The smoothed outline that all contours are compared with, and the places along it. `places` are arc lengths at
    equal steps, mm; `middle` is the centre of rotation and scale, mm; `estimate` takes offsets at the places to
    `PARTS`; the orthonormal columns of `basis` span what `PARTS` do to the offsets.
    """

    outline: Interface
    places: PerPlace
    step: float
    middle: Float[np.ndarray, "2"]
    estimate: Float[np.ndarray, "part place"]
    basis: Float[np.ndarray, "place column"]

    def offsets(self, contour: Interface, most: float) -> PerPlace:
        """Return the signed distance of the contour's point next to each place, mm; nothing is interpolated."""
        path = path_of(contour)
        nearest = _nearest(_feet(path, self.outline), self.places, self.outline, most)
        return signed_distances(path[nearest], self.outline)


def _frame(longest: Interface, contours: Sequence[Interface]) -> _Frame:
    path, closed = path_of(longest), longest.closed
    half = max(len(path) // (2 * PIECES), 2)
    outline = Interface.polyline(smoothed(path, half, closed=closed), closed=closed)
    places, step = _places(outline, [_feet(path_of(one), outline) for one in contours])
    middle = outline.points.mean(axis=0)
    effects, scales = _effects(outline, places, step, middle)
    left, sizes, right = np.linalg.svd(effects, full_matrices=False)
    strong, basis = sizes > _WEAKEST * sizes[0], np.ascontiguousarray(left[:, sizes > _NONE * sizes[0]])
    estimate = (right[strong].T / sizes[strong]) @ left[:, strong].T * scales[:, None]
    return _Frame(outline, places, step, middle, estimate, basis)


def _feet(path: Float[np.ndarray, "point 2"], outline: Interface) -> Float[np.ndarray, " point"]:
    """Return the arc length of the closest point of the outline to each point, mm."""
    found = closest_points(path, outline)
    begin = np.concatenate([[0.0], np.cumsum(outline.lengths)[:-1]])
    return np.asarray(begin[found.cells] + np.linalg.norm(found.points - outline.starts[found.cells], axis=1))


def _places(outline: Interface, feet: Sequence[Float[np.ndarray, " _"]]) -> tuple[PerPlace, float]:
    """Return places along the part of the outline that all contours show, as far apart as points of the coarsest."""
    whole = float(outline.lengths.sum())
    if outline.closed:
        number = min(len(one) for one in feet)
        return np.arange(number) * (whole / number), whole / number
    low = max(ENDS * whole, *(float(one.min()) for one in feet))
    high = min((1 - ENDS) * whole, *(float(one.max()) for one in feet))
    step = max(float(np.ptp(one)) / (len(one) - 1) for one in feet)
    number = math.floor((high - low) / step) + 1 if high > low and step > 0 else 0
    if number < _FEWEST_PLACES:
        raise InvalidInput(
            "part of the outline that all contours show",
            value=f"{max(high - low, 0.0):.3g} mm, with {max(number, 0)} points of the coarsest",
            expected=f"at least {_FEWEST_PLACES} points of each contour",
            remedy="Give contours of one state in one coordinate system, cut at the same ends.",
        )
    return low + step * np.arange(number), step


def _effects(
    outline: Interface, places: PerPlace, step: float, middle: Float[np.ndarray, "2"]
) -> tuple[Float[np.ndarray, "place part"], Float[np.ndarray, " part"]]:
    """Return what `PARTS` do to the offsets at the places, each in units that move the outline by about 1 mm. Also
    returns these units: mm, mm, degrees, a share, mm.
    """
    along = np.concatenate([[0.0], np.cumsum(outline.lengths)])
    path = outline.points[np.append(outline.cells[:, 0], outline.cells[-1, 1])]
    arm = np.stack([np.interp(places, along, path[:, axis]) for axis in (0, 1)], axis=1) - middle
    normals = normals_at(outline, places, 2 * step)
    turn = arm[:, 0] * normals[:, 1] - arm[:, 1] * normals[:, 0]
    reach = float(np.sqrt((arm**2).sum(axis=1).mean()))
    stretch = (arm * normals).sum(axis=1)
    effects = np.column_stack([normals, turn / reach, stretch / reach, np.ones(len(places))])
    return effects, np.array([1.0, 1.0, math.degrees(1 / reach), 1 / reach, 1.0])


def _nearest(
    feet: Float[np.ndarray, " point"], places: PerPlace, outline: Interface, most: float
) -> Int[np.ndarray, " place"]:
    """Return the number of the point whose foot is next to each place."""
    order, whole = np.argsort(feet), float(outline.lengths.sum())
    along = feet[order]
    if outline.closed:
        order = np.concatenate([order[-1:], order, order[:1]])
        along = np.concatenate([along[-1:] - whole, along, along[:1] + whole])
    after = np.clip(np.searchsorted(along, places), 1, len(along) - 1)
    chosen = np.where(places - along[after - 1] < along[after] - places, after - 1, after)
    gap = float(np.abs(along[chosen] - places).max())
    if gap > most:
        expected = f"a point at least every {2 * most:.3g} mm, ten times the usual distance"
        remedy = "Give contours without gaps, in one coordinate system."
        raise unfit("gap in a contour", f"{2 * gap:.3g} mm without a point", expected, remedy)
    return np.asarray(order[chosen])


def _moved_back(contour: Interface, part: Float[np.ndarray, " part"], middle: Float[np.ndarray, "2"]) -> Interface:
    """Return the contour without its shift, rotation and scale."""
    c, s = math.cos(math.radians(part[2])), math.sin(math.radians(part[2]))
    turned = (contour.points - middle - part[:2]) @ np.array([[c, -s], [s, c]])
    return Interface(middle + turned / (1 + part[3]), contour.cells)


def _local(offsets: Float[np.ndarray, "contour place"], frame: _Frame) -> Correlated:
    """Return the local errors of the points of a contour, from offsets without mean and common errors."""
    closed = frame.outline.closed
    of_one = len(offsets) / (len(offsets) - 1)  # variance of errors over that of their difference from the mean
    covariance = of_one * autocovariance(offsets, closed=closed)
    if not math.sqrt(covariance[0]) > 1e-9 * frame.step:
        raise unfit("contours of one state", "identical contours", "one contour per picture", "Remove the duplicates.")
    removed = frame.basis.shape[1] * autocovariance(np.ascontiguousarray(frame.basis.T), closed=closed)
    return restored(covariance, removed)


def _errors(local: Correlated, parts: Float[np.ndarray, "contour part"], frame: _Frame) -> PointErrors:
    """Return local errors, and those common errors whose spread the local ones do not explain."""
    degrees = len(parts) - 1
    spread = (parts**2).sum(axis=0) / degrees
    explained = local.level * (frame.estimate**2).sum(axis=1)

    def beyond(some: list[int]) -> float:
        found, own = float(spread[some].mean()), float(explained[some].mean())
        freedom = degrees * len(some)
        certain = 2 * float(gammaincinv(0.5 * freedom, CERTAIN)) / freedom
        return math.sqrt(found - own) if found > certain * own else 0.0

    shift, rotation, scale, offset = (beyond(some) for some in ([0, 1], [2], [3], [4]))
    length = local.length(frame.step)
    return PointErrors(math.sqrt(local.variance), length, shift, rotation, scale, offset)


def _notes(local: Correlated, contours: int) -> list[str]:
    notes = [
        "repeats never show an error that all of them share, such as a threshold that is always a little too low, the "
        "size of a pixel, or the place of the picture: add these under `unknown` (`offset`, `scale`, `shift`)"
    ]
    if contours < FEW:
        notes.append(f"{contours} contours only: take the common errors as a guess; {FEW} or more show them better")
    if local.cut:
        notes.append(
            "errors are correlated over much of the outline, so sd and length are underestimated; did the outline "
            "change between pictures?"
        )
    return notes
