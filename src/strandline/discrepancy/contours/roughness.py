"""Errors of the points of a single contour, from its roughness: its distances to itself smoothed."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.discrepancy.contours.correlation import Correlated, autocovariance, restored
from strandline.discrepancy.contours.paths import path_of, require_contours, smoothed, smoothing_weights
from strandline.discrepancy.normal_offset import signed_distances
from strandline.errors import InvalidInput
from strandline.interface import Interface, PointErrors

__all__ = ["Roughness", "errors_from_roughness"]

LENGTHS = 20.0
"""Length of the smoothed pieces in correlation lengths."""
WIDEST = 8
"""The outline has at least as many such pieces, unless it has few points."""
ENOUGH = 17.0
"""Length of the smoothed pieces in correlation lengths from which the correlation length can be trusted; in pieces that
are too short, a sixteenth of their length is found whatever it is."""
_FEWEST, _LEAST = 3, 4
"""Points on either side of a smoothed one: fewest that may be asked for, and fewest by default."""


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
        raise InvalidInput(
            "window of the roughness",
            value=f"{window:.4g} mm",
            expected=f"a length from {low:.3g} mm, six spacings of the points, to {high:.3g} mm, half the contour",
            remedy="Leave it out, or take 20 times the distance over which neighbouring errors are alike.",
        )
    return min(max(round(0.5 * window / spacing), _FEWEST), (len(contour.points) - 1) // 4)


def _smoothed_away(path: Float[np.ndarray, "point 2"], half: int, *, closed: bool) -> tuple[Correlated, float]:
    """Return the errors of points about their smoothed path, and the distance of its points, mm."""
    course = Interface.polyline(smoothed(path, half, closed=closed), closed=closed)
    residuals = signed_distances(path, course)
    inside = residuals if closed else residuals[half:-half]
    covariance, step = autocovariance(inside[None], closed=closed), float(course.lengths.mean())
    if not math.sqrt(covariance[0]) > 1e-9 * step:
        raise InvalidInput(
            "roughness of the contour",
            value=f"{math.sqrt(covariance[0]):.3g} mm",
            expected="a contour that still has its noise",
            remedy="Give the contour as it was found in the picture, neither smoothed nor drawn.",
        )
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
