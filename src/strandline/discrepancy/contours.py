"""Errors of the points of a single contour, from its roughness: its distances to itself smoothed.

Errors at equal steps h along an outline have the autocovariance c(k), the variance s² = c(0) and the correlation length
ℓ = ∫₀^∞ ρ dt = ½ h Σ c(k) / s². Their level at low frequencies, S = Σ c(k) = 2s²ℓ/h over all lags, is what limits how
well inputs can be known.

Residuals are such errors without something smooth that was removed from them, such as a shift or their own smoothed
course. If that is smooth over lengths well above ℓ, it takes S q(k) from c(k), with q known from what was removed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.discrepancy.comparison import extent, extent_ratio, unit_mistake
from strandline.discrepancy.normal_offset import signed_distances
from strandline.discrepancy.protocol import require_polylines
from strandline.foundations import unfit
from strandline.interface import Interface, PointErrors

MOST_REMOVED = 0.5  # share of the level that the removed part may have taken from the lags that are added up
CLEARLY = 0.2  # correlation at the lag after these from which errors count as correlated over more than they span
FEWEST_POINTS = 30
LENGTHS = 20.0  # length of the smoothed pieces in correlation lengths
WIDEST = 8  # the outline has at least as many such pieces, unless it has few points
ENOUGH = 17.0
"""Length of the smoothed pieces in correlation lengths from which the correlation length can be trusted; in pieces that
are too short, a sixteenth of their length is found whatever it is."""
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
    for number, contour in enumerate(contours, 1):
        if len(contour.points) < FEWEST_POINTS:
            expected = f"at least {FEWEST_POINTS}, to know how neighbouring errors are related"
            remedy = "Give the contour as it was found, one point a pixel, neither thinned nor smoothed."
            raise unfit(f"points of contour {number}", len(contour.points), expected, remedy)
        _require_alike(contours[0], contour, number)


def _require_alike(first: Interface, other: Interface, number: int) -> None:
    if other.closed != first.closed:
        kinds = {True: "closed", False: "open"}
        found = f"contour 1 is {kinds[first.closed]}, contour {number} {kinds[other.closed]}"
        remedy = "Cut them at the same ends, or close them all."
        raise unfit("contours of one state", found, "all open or all closed (the last point repeats the first)", remedy)
    mistake = unit_mistake(extent_ratio(other, first))
    if mistake:
        found = f"contour 1 is {extent(first):.4g} mm across, contour {number} {extent(other):.4g} mm"
        remedy = "Give all of them in the same unit; leave out what shows something else."
        raise unfit("sizes of contours of one state", found, "contours of one state in one unit", remedy)


@dataclass(frozen=True)
class Roughness:
    """What one contour shows of the errors of its points.

    Args:
        errors: Standard deviation and correlation length, both too low if errors are alike over much of the window.
        spacing: Distance of neighbouring points along the smoothed contour, mm.
        window: Length of the smoothed pieces, mm.
        notes: Sentences on what these numbers leave out.
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
    return Roughness(errors, step, whole, tuple(_notes(short=found.cut or whole < ENOUGH * errors.length)))


def _half(window: float, contour: Interface) -> int:
    """Return how many points on either side a window reaches."""
    spacing = float(contour.lengths.mean())
    low, high = 2 * _FEWEST * spacing, 0.5 * float(contour.lengths.sum())
    if not low <= window <= high:
        expected = f"a length from {low:.3g} mm, six spacings of the points, to {high:.3g} mm, half the contour"
        remedy = "Leave it out, or take 20 times the distance over which neighbouring errors are alike."
        raise unfit("window of the roughness", f"{window:.4g} mm", expected, remedy)
    return min(max(round(0.5 * window / spacing), _FEWEST), (len(contour.points) - 1) // 4)


def _smoothed_away(path: Float[np.ndarray, "point 2"], half: int, *, closed: bool) -> tuple[Correlated, float]:
    """Return the errors of points about their smoothed path, and the distance of its points, mm."""
    course = Interface.polyline(smoothed(path, half, closed=closed), closed=closed)
    residuals = signed_distances(path, course)
    inside = residuals if closed else residuals[half:-half]
    covariance, step = autocovariance(inside[None], closed=closed), float(course.lengths.mean())
    if not math.sqrt(covariance[0]) > 1e-9 * step:
        expected = "a contour that still has its noise"
        remedy = "Give the contour as it was found in the picture, neither smoothed nor drawn."
        raise unfit("roughness of the contour", f"{math.sqrt(covariance[0]):.3g} mm", expected, remedy)
    return restored(covariance, _removed(half, len(covariance))), step


def _removed(half: int, number: int) -> Float[np.ndarray, " lag"]:
    """Return q(k) = 2g(k) - (g*g)(k): errors e lose their smoothed course g*e, and c(k) the level times q(k)."""
    weights = smoothing_weights(half)
    q = -np.convolve(weights, weights)
    q[half : 3 * half + 1] += 2 * weights
    return np.pad(q[2 * half :], (0, max(number - 2 * half - 1, 0)))[:number]


def _notes(*, short: bool) -> list[str]:
    """Return remarks on any single contour, and on a window that is short against the correlation length."""
    notes = [
        "one contour does not show a shift, rotation, scale or offset of the whole: state them under `unknown`",
        "errors correlated over most of the window look like shape, so sd² × length is underestimated; corners and "
        "bends shorter than the window look like errors, so it is overestimated; repeated pictures tell them apart",
    ]
    if short:
        notes.append(
            "the window is short against the correlation length: do not trust the length; sd² × length may be three "
            "times as large"
        )
    return notes
