"""The first path: a rough polyline along the edge in a picture, and what it must fulfil."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from strandline.foundations import InvalidInterface
from strandline.interface import Interface
from strandline.readers import is_finite, unfit

FEWEST, MOST = 3, 20_000
"""Smallest and largest number of points of a path, and of corners of a region."""


class FirstPath(NamedTuple):
    """A polyline near the edge, from which the search for the edge starts.

    `points`: pixel coordinates (x, y), in their order along the edge; y points down and the centre of the top left
    pixel is (0, 0). `closed`: whether the last point is joined to the first.
    """

    points: Float[np.ndarray, "point 2"]
    closed: bool = False


def typed_path(
    points: object, *, closed: bool = False, size: tuple[int, int] | None = None, what: str = "the path"
) -> FirstPath:
    """Return the path through points that somebody typed.

    Args:
        points: Rows (x, y) in pixels: a list of pairs, or an array.
        closed: Whether the last point is joined to the first.
        size: Width and height of the picture in pixels, if the points must lie in it.
        what: Name of the path in messages, e.g. ``observation.path``.

    Raises:
        InvalidInput: Something that is not a list of pairs of finite numbers, fewer than 3 points, a point outside the
            picture, a repeated point, or a path that crosses itself.
    """
    found = as_points(points, what)
    if size is not None:
        require_inside(found, size, what)
    require_path(found, what, closed=closed)
    return FirstPath(found, closed)


def as_points(found: object, what: str) -> Float[np.ndarray, "point 2"]:
    """Return a list of pairs of numbers as an array; refusals count points from 1."""
    rows = found.tolist() if isinstance(found, np.ndarray) else found
    if not isinstance(rows, Sequence) or isinstance(rows, str):
        raise unfit(what, found, "a list of points [x, y] in pixels")
    for number, row in enumerate(rows, 1):
        pair = isinstance(row, Sequence) and not isinstance(row, str) and len(row) == 2
        if not (pair and all(isinstance(v, int | float) and not isinstance(v, bool) for v in row)):
            raise unfit(f"{what}: point {number}", row, "two numbers [x, y], in pixels")
        if not all(is_finite(value) for value in row):
            raise unfit(f"{what}: point {number} is not finite", row, "two finite numbers [x, y], in pixels")
    return np.array(rows, dtype=float).reshape(-1, 2)


def require_path(points: Float[np.ndarray, "point 2"], what: str, *, closed: bool) -> None:
    """Refuse points that make no path: too few, repeated or not finite, or a path that crosses itself."""
    require_polygon(points, what)
    following = np.roll(points, -1, axis=0) if closed else points[1:]
    repeated = np.flatnonzero((points[: len(following)] == following).all(axis=1))
    if repeated.size:
        first, second = int(repeated[0]) + 1, (int(repeated[0]) + 1) % len(points) + 1
        raise unfit(
            f"{what}: points {first} and {second} coincide",
            points[first - 1].tolist(),
            "points that differ from the ones before them",
            "Remove one of the two; a closed path does not repeat its first point.",
        )
    require_simple(points, what, closed=closed)


def require_simple(points: Float[np.ndarray, "point 2"], what: str, *, closed: bool) -> None:
    """Refuse a path that crosses or touches itself."""
    try:
        Interface.polyline(points, closed=closed).require_simple()
    except InvalidInterface as error:
        raise unfit(
            f"{what} crosses or touches itself",
            str(error.value).removesuffix("mm") + "px",
            "a path without crossings, its points in order along the edge",
            "Move or remove points there.",
        ) from None


def require_polygon(points: Float[np.ndarray, "point 2"], what: str) -> None:
    """Refuse points that are too few, too many or not finite."""
    if len(points) < FEWEST:
        raise unfit(f"{what} has too few points", len(points), f"at least {FEWEST}", "Click more of them.")
    if len(points) > MOST:
        remedy = "Leave some out: 5 to 12 along the edge are enough."
        raise unfit(f"{what} has too many points", len(points), f"at most {MOST}", remedy)
    require_finite(points, what)


def require_finite(points: Float[np.ndarray, "point 2"], what: str) -> None:
    """Refuse points of which a coordinate is no number; the message counts points from 1."""
    wrong = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if wrong.size:
        number = int(wrong[0]) + 1
        raise unfit(f"{what}: point {number} is not finite", points[number - 1].tolist(), "finite numbers")


def require_inside(points: Float[np.ndarray, "point 2"], size: tuple[int, int], what: str) -> None:
    """Refuse points outside a picture, whose pixels reach from -0.5 to width - 0.5 and to height - 0.5."""
    width, height = size
    outside = np.flatnonzero(((points < -0.5) | (points > np.array([width, height]) - 0.5)).any(axis=1))
    if outside.size:
        number = int(outside[0]) + 1
        raise unfit(
            f"{what}: point {number} is outside the picture",
            points[number - 1].tolist(),
            f"x from -0.5 to {width - 0.5:g} and y from -0.5 to {height - 0.5:g} px",
            "Move the point, or give the picture that the points belong to.",
        )
