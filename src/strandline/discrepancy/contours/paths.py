"""Contours as paths: their points in order, smoothed, and which contours can be compared."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from strandline.discrepancy.extents import extent, extent_ratio, unit_mistake
from strandline.discrepancy.protocol import require_polylines
from strandline.errors import InvalidInput
from strandline.interface import Interface

__all__ = ["FEWEST_POINTS", "path_of", "require_contours", "smoothed", "smoothing_weights"]

FEWEST_POINTS = 30


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
    """Refuse contours that are surfaces, short, or not of one kind and size.

    Raises:
        InvalidInput: They are one of these; the message says which, counted from 1.
    """
    require_polylines(*contours)
    for number, contour in enumerate(contours, 1):
        if len(contour.points) < FEWEST_POINTS:
            raise InvalidInput(
                f"points of contour {number}",
                value=len(contour.points),
                expected=f"at least {FEWEST_POINTS}, to know how neighbouring errors are related",
                remedy="Give the contour as it was found, one point a pixel, neither thinned nor smoothed.",
            )
        _require_alike(contours[0], contour, number)


def _require_alike(first: Interface, other: Interface, number: int) -> None:
    if other.closed != first.closed:
        kinds = {True: "closed", False: "open"}
        raise InvalidInput(
            "contours of one state",
            value=f"contour 1 is {kinds[first.closed]}, contour {number} {kinds[other.closed]}",
            expected="all open or all closed (the last point repeats the first)",
            remedy="Cut them at the same ends, or close them all.",
        )
    mistake = unit_mistake(extent_ratio(other, first))
    if mistake:
        raise InvalidInput(
            "sizes of contours of one state",
            value=f"contour 1 is {extent(first):.4g} mm across, contour {number} {extent(other):.4g} mm",
            expected="contours of one state in one unit",
            remedy="Give all of them in the same unit; leave out what shows something else.",
        )
