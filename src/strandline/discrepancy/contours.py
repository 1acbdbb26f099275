"""Errors of the points of an outline: from its contours in repeated pictures, or from the roughness of a single one.

Errors at equal steps h along an outline have the autocovariance c(k), the variance s² = c(0) and the correlation length
ℓ = ∫₀^∞ ρ dt = ½ h Σ c(k) / s². Their level at low frequencies, S = Σ c(k) = 2s²ℓ/h over all lags, is what limits how
well inputs can be known.

Residuals are such errors without something smooth that was removed from them, such as a shift or their own smoothed
course. If that is smooth over lengths well above ℓ, it takes S q(k) from c(k), with q known from what was removed.

All contours of one state are compared with the smoothed longest one, point by point along it. What they have in common,
the true outline minus the smoothed one, goes with their mean. What is left of n contours has (n-1)/n of the variance of
their errors. From each contour's offsets the shift, rotation, scale and offset that explain most of them are removed;
what these take from the local errors is known (`restored`), as is what local errors add to their spread.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.special import gammaincinv

from strandline.discrepancy.comparison import extent, extent_ratio, unit_mistake
from strandline.discrepancy.nearest import closest_points
from strandline.discrepancy.normal_offset import signed_distances
from strandline.discrepancy.protocol import require_polylines
from strandline.foundations import require
from strandline.interface import Interface, PointErrors, normals_at, oriented_like

MOST_REMOVED = 0.5  # share of the level that the removed part may have taken from the lags that are added up
CLEARLY = 0.2  # correlation at the lag after these from which errors count as correlated over more than they span
FEWEST_POINTS = 30
LENGTHS = 20.0  # length of the smoothed pieces in correlation lengths
WIDEST = 8  # the outline has at least as many such pieces, unless it has few points
ENOUGH = 17.0
"""Length of the smoothed pieces in correlation lengths from which the correlation length can be trusted; in pieces that
are too short, a sixteenth of their length is found whatever it is."""
_OF_ONE_CONTOUR = (
    "one contour does not show a shift, rotation, scale or offset of the whole: state them under `unknown`",
    "errors correlated over most of the window look like shape, so sd² × length is underestimated; corners and "
    "bends shorter than the window look like errors, so it is overestimated; repeated pictures tell them apart",
)
_OF_SHORT_WINDOW = (
    "the window is short against the correlation length: do not trust the length; sd² × length may be three times as "
    "large",
)
_FEWEST, _LEAST = 3, 4  # points on either side of a smoothed one: fewest that may be asked for, and fewest by default


@dataclass(frozen=True)
class Correlated:
    """Errors at equal steps along an outline: their variance s², and level at low frequencies S = 2s²ℓ/h ≥ s², mm².

    `cut` tells whether they are still clearly correlated at the first lag that could not be added up.
    """

    variance: float
    level: float
    cut: bool

    def length(self, step: float) -> float:
        """Return the correlation length ℓ for steps of this length h, mm; at least h/2, that of independent points."""
        return 0.5 * step * self.level / self.variance


def autocovariance(values: Float[np.ndarray, "row place"], *, closed: bool) -> Float[np.ndarray, " lag"]:
    """Return the mean of v_i v_{i+k} over rows and places, for lags k up to a quarter of the places."""
    number = values.shape[1]
    if closed:
        return np.array([float(np.mean(values * np.roll(values, -k, axis=1))) for k in range(number // 4 + 1)])
    return np.array([float(np.mean(values[:, : number - k] * values[:, k:])) for k in range(number // 4 + 1)])


def restored(covariance: Float[np.ndarray, " lag"], removed: Float[np.ndarray, " lag"]) -> Correlated:
    """Return variance and level of errors from the autocovariance of their residuals.

    c(k) + S q(k) is added up to its first zero, or to where the removed part has taken half. S is in this sum too; it
    grows with every lag at which the sum's new term is above 0, so one pass finds both. The residuals differ from 0.
    Factors q(k) are 0 if nothing was removed.
    """
    sums = covariance[0] + 2 * np.concatenate([[0.0], np.cumsum(covariance[1:])])
    shares = removed[0] + 2 * np.concatenate([[0.0], np.cumsum(removed[1:])])
    k, level = 0, float(sums[0] / (1 - shares[0]))

    def at(lag: int) -> float:
        return float(covariance[lag] + level * removed[lag])

    while k + 1 < len(covariance) and shares[k + 1] <= MOST_REMOVED and at(k + 1) > 0:
        k += 1
        level = float(sums[k] / (1 - shares[k]))
    return Correlated(at(0), level, at(min(k + 1, len(covariance) - 1)) > CLEARLY * at(0))


def path_of(contour: Interface) -> Float[np.ndarray, "point 2"]:
    """Return the points of a polyline in their order; the first of a closed one is not repeated."""
    path = contour.points[contour.cells[:, 0]]
    return path if contour.closed else np.vstack([path, contour.points[contour.cells[-1:, 1]]])


def smoothing_weights(half: int) -> Float[np.ndarray, " neighbour"]:
    """Return the weights with which the `half` points on either side enter a smoothed point; their sum is 1.

    The smoothed point lies on the parabola of least squares through its neighbours and itself (Savitzky, Golay 1964).
    """
    k = np.arange(-half, half + 1)
    return np.asarray(3 * (3 * half**2 + 3 * half - 1 - 5 * k**2) / ((2 * half - 1) * (2 * half + 1) * (2 * half + 3)))


def smoothed(path: Float[np.ndarray, "point 2"], half: int, *, closed: bool) -> Float[np.ndarray, "point 2"]:
    """Return the path with each point replaced by the parabola through the `half` points on either side.

    Beyond its ends an open path goes on as its image, turned by half a turn about the end.
    """
    ends = ((half, half), (0, 0))
    padded = np.pad(path, ends, mode="wrap") if closed else np.pad(path, ends, mode="reflect", reflect_type="odd")
    weights = smoothing_weights(half)
    return np.stack([np.convolve(column, weights, mode="valid") for column in padded.T], axis=1)


def require_contours(contours: Sequence[Interface]) -> None:
    """Refuse contours that are surfaces, short, or not of one kind and size."""
    require_polylines(*contours)
    first, kinds = contours[0], {True: "closed", False: "open"}
    for number, other in enumerate(contours, 1):
        expected = f"at least {FEWEST_POINTS}, to know how neighbouring errors are related"
        remedy = "Give the contour as it was found, one point a pixel, neither thinned nor smoothed."
        require(len(other.points) >= FEWEST_POINTS, f"points of contour {number}", len(other.points), expected, remedy)
        found = f"contour 1 is {kinds[first.closed]}, contour {number} {kinds[other.closed]}"
        expected = "all open or all closed (the last point repeats the first)"
        remedy = "Cut them at the same ends, or close them all."
        require(other.closed == first.closed, "contours of one state", found, expected, remedy)
        found = f"contour 1 is {extent(first):.4g} mm across, contour {number} {extent(other):.4g} mm"
        remedy = "Give all of them in the same unit; leave out what shows something else."
        alike = not unit_mistake(extent_ratio(other, first))
        require(alike, "sizes of contours of one state", found, "contours of one state in one unit", remedy)


@dataclass(frozen=True)
class Roughness:
    """What one contour shows of the errors of its points; `notes` say what the numbers leave out.

    Standard deviation and correlation length are too low if errors are alike over much of the `window`, the length of
    the smoothed pieces, mm. `spacing` is the distance of neighbouring points along the smoothed contour, mm.
    """

    errors: PointErrors
    spacing: float
    window: float
    notes: tuple[str, ...]


def errors_from_roughness(contour: Interface, *, window: float | None = None) -> Roughness:
    """Return the errors of the points of a contour from its distances to itself smoothed.

    Smoothing removes the outline, and with it the slow part of the errors. What is missing in variance and correlation
    length is added in the approximation that the window is long against the correlation length.

    Args:
        contour: A contour as it was found, not smoothed.
        window: Length of the pieces in which the contour is replaced by a parabola, mm. They should have many
            correlation lengths, and the outline no more than a bend. Default: 20 correlation lengths, at most an eighth
            of the contour.

    Raises:
        InvalidInput: A surface, fewer than 30 points, a window that does not fit, or a contour without roughness.
    """
    require_contours([contour])
    path, closed = path_of(contour), contour.closed
    if window is None:
        half = max(len(path) // (2 * WIDEST), _LEAST)
        found, step = _smoothed_away(path, half, closed=closed)
        half = min(max(math.ceil(0.5 * LENGTHS * found.length(step) / step), _LEAST), half)
    else:
        half = _half(window, contour)
    found, step = _smoothed_away(path, half, closed=closed)
    errors = PointErrors(math.sqrt(found.variance), found.length(step))
    whole = 2 * half * step
    short = _OF_SHORT_WINDOW if found.cut or whole < ENOUGH * errors.length else ()
    return Roughness(errors, step, whole, (*_OF_ONE_CONTOUR, *short))


def _half(window: float, contour: Interface) -> int:
    """Return how many points on either side a window reaches."""
    spacing = float(contour.lengths.mean())
    low, high = 2 * _FEWEST * spacing, 0.5 * float(contour.lengths.sum())
    expected = f"a length from {low:.3g} mm, six spacings of the points, to {high:.3g} mm, half the contour"
    remedy = "Leave it out, or take 20 times the distance over which neighbouring errors are alike."
    require(low <= window <= high, "window of the roughness", f"{window:.4g} mm", expected, remedy)
    return min(max(round(0.5 * window / spacing), _FEWEST), (len(contour.points) - 1) // 4)


def _smoothed_away(path: Float[np.ndarray, "point 2"], half: int, *, closed: bool) -> tuple[Correlated, float]:
    """Return the errors of points about their smoothed path, and the distance of its points, mm."""
    course = Interface.polyline(smoothed(path, half, closed=closed), closed=closed)
    residuals = signed_distances(path, course)
    inside = residuals if closed else residuals[half:-half]
    covariance, step = autocovariance(inside[None], closed=closed), float(course.lengths.mean())
    rms, expected = math.sqrt(covariance[0]), "a contour that still has its noise"
    remedy = "Give the contour as it was found in the picture, neither smoothed nor drawn."
    require(rms > 1e-9 * step, "roughness of the contour", f"{rms:.3g} mm", expected, remedy)
    return restored(covariance, _removed(half, len(covariance))), step


def _removed(half: int, number: int) -> Float[np.ndarray, " lag"]:
    """Return q(k) = 2g(k) - (g*g)(k): errors e lose their smoothed course g*e, and c(k) the level times q(k)."""
    weights = smoothing_weights(half)
    q = -np.convolve(weights, weights)
    q[half : 3 * half + 1] += 2 * weights
    return np.pad(q[2 * half :], (0, max(number - 2 * half - 1, 0)))[:number]


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
_OF_REPEATS = (
    "repeats never show an error that all of them share, such as a threshold that is always a little too low, the "
    "size of a pixel, or the place of the picture: add these under `unknown` (`offset`, `scale`, `shift`)"
)
_OF_LONG_CORRELATION = (
    "errors are correlated over much of the outline, so sd and length are underestimated; did the outline change "
    "between pictures?"
)
_GAP = 5.0  # largest gap in a contour, in steps, after its shift and rotation were undone in two passes
_FEWEST_PLACES = 20


@dataclass(frozen=True, eq=False)
class Repeats:
    """What several contours of one state show of the errors of their points; `notes` say what the numbers leave out.

    A common error is 0 if the local ones explain its spread. The contours were compared at so many `places` along the
    outline, `spacing` apart, mm. `parts` are shift in x and y, rotation, scale and offset of each contour against the
    mean, in the units of `PARTS`.
    """

    errors: PointErrors
    spacing: float
    places: int
    parts: Float[np.ndarray, "contour part"]
    notes: tuple[str, ...]


def errors_from_repeats(contours: Sequence[Interface]) -> Repeats:
    """Return the errors of the points of contours that show one state, each from its own picture.

    There are two contours or more, of at least 30 points; neither points nor directions need to correspond.

    Raises:
        InvalidInput: Fewer contours or points, open and closed contours, sizes ten times apart, contours that overlap
            too little or have gaps, or that agree exactly.
    """
    words = "at least 2; better 5 or more", "For a single contour, take errors_from_roughness."
    require(len(contours) >= 2, "number of contours of one state", len(contours), *words)
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
    notes = [_OF_REPEATS]
    if len(alike) < FEW:
        notes.append(f"{len(alike)} contours only: take the common errors as a guess; {FEW} or more show them better")
    notes += [_OF_LONG_CORRELATION] if local.cut else []
    return Repeats(_errors(local, parts, frame), frame.step, len(frame.places), parts, tuple(notes))


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
    found = f"{max(high - low, 0.0):.3g} mm, with {max(number, 0)} points of the coarsest"
    expected = f"at least {_FEWEST_PLACES} points of each contour"
    remedy = "Give contours of one state in one coordinate system, cut at the same ends."
    require(number >= _FEWEST_PLACES, "part of the outline that all contours show", found, expected, remedy)
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
    expected = f"a point at least every {2 * most:.3g} mm, ten times the usual distance"
    remedy = "Give contours without gaps, in one coordinate system."
    require(not gap > most, "gap in a contour", f"{2 * gap:.3g} mm without a point", expected, remedy)
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
    words = "contours of one state", "identical contours", "one contour per picture", "Remove the duplicates."
    require(math.sqrt(covariance[0]) > 1e-9 * frame.step, *words)
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
    return PointErrors(math.sqrt(local.variance), local.length(frame.step), shift, rotation, scale, offset)
