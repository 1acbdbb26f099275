"""The edge between a solid and its surroundings in a picture, sub-pixel, with its errors."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import median_filter

from strandline.foundations import InvalidInput
from strandline.imaging.edges.edge_checks import (
    FEWEST,
    EdgeCheck,
    EdgeErrors,
    edge_checks,
    edge_errors,
    require_edge,
    require_path,
    require_room,
)
from strandline.imaging.edges.edge_methods import edge_method
from strandline.imaging.edges.strip import (
    EdgeMethod,
    GreyValues,
    Located,
    SmoothPath,
    Strip,
    course_through,
    grey_values,
    smoothed,
    strip_along,
)
from strandline.interface import inside_polygon

SMOOTH = 5.0
"""Standard deviation of the Gaussian along the path that smooths it before the edge is looked for, px."""
CLEAR, ASIDE = 8.0, 2.0
"""Distance from the path within which a normal must not meet an excluded polygon, and from the normal, px."""
_STRAY, _NEAR = 2.0, 21
"""Distance from the median of so many neighbours beyond which a point is not used to put the path right, px."""


@dataclass(frozen=True, eq=False)
class Edge:
    """An edge, in its order along the path, with the solid on the right as the picture is seen.

    Once y points up, its normals are therefore those of `Interface` and point out of the solid.

    Args:
        points: Points (x, y) in pixel coordinates, about one a pixel, not smoothed, shape (point, 2).
        normals: Unit normals out of the solid, in the plane of the picture with x to the right and y down, in lengths
            and not in pixels, shape (point, 2).
        arc: Arc length of each point along the smooth path under the edge, in the unit of the pixel size.
        sds: Standard deviation of each point along its normal, in that unit; see `errors.sd` for all of them.
        errors: Errors that the picture shows.
        strip: Samples along the normals of the whole path, in units of the smaller side of a pixel.
        offsets: Distance of the edge from the middle of the strip on each of its normals, in that unit.
        kept: Normals of the strip whose points are kept, shape (normal,).
        closed: Whether the last point is followed by the first.
        method: The way the edge was found.
        unit: Length of the smaller side of a pixel, in the unit of the pixel size.
    """

    points: Float[np.ndarray, "point 2"]
    normals: Float[np.ndarray, "point 2"]
    arc: Float[np.ndarray, " point"]
    sds: Float[np.ndarray, " point"]
    errors: EdgeErrors
    strip: Strip
    offsets: Float[np.ndarray, " normal"]
    kept: Bool[np.ndarray, " normal"]
    closed: bool
    method: EdgeMethod
    unit: float

    @property
    def checks(self) -> tuple[EdgeCheck, ...]:
        """What the picture shows of the edge, each number with the limit beyond which it would be refused."""
        return edge_checks(len(self.points), self.errors, unit=self.unit)

    def __repr__(self) -> str:
        e = self.errors
        return (
            f"Edge({len(self.points)} points, sd {e.sd:.3g}, length {e.length:.3g}, offset {e.offset:.3g}, "
            f"contrast/noise {e.contrast_to_noise:.3g}, blur {e.blur:.3g})"
        )


def find_edge(
    values: np.ndarray,
    path: np.ndarray,
    *,
    method: str | EdgeMethod = "erf",
    solid: str = "bright",
    closed: bool = False,
    exclude: Sequence[np.ndarray] = (),
    pixel: tuple[float, float] = (1.0, 1.0),
    trim: float = 0.05,
) -> Edge:
    """Return the edge near a path in a picture.

    Args:
        values: Grey values [row, column]; for method `path` linear intensity. Those that are not finite do not count.
        path: Points (x, y) along the edge in their order, in pixel coordinates: x to the right, y down, the centre of
            the top left pixel at (0, 0). A few clicks will do, within some pixels of the edge.
        method: Name of an entry of `EDGES`, ``module:name``, or an `EdgeMethod`.
        solid: ``bright`` or ``dark``: the side of the solid; this sets the direction of the edge.
        closed: Whether the path returns to its first point.
        exclude: Polygons in pixel coordinates to be left out.
        pixel: Width and height of a pixel; normals and errors are lengths in this unit.
        trim: Share of an open edge that is left out at each end.

    Raises:
        InvalidInput: The path crosses itself or leaves the picture, or the picture says too little about the edge; see
            `strandline.imaging.edges.edge_checks`.
    """
    if solid not in ("bright", "dark"):
        raise InvalidInput("side of the solid", value=solid, expected="bright or dark", remedy="Choose one of them.")
    if not 0 <= trim < 0.5:
        raise InvalidInput(
            "share of the edge left out at each end", value=trim, expected="0 or above, below 0.5", remedy="Use 0.05."
        )
    way = edge_method(method)
    picture = grey_values(values, pixel=pixel, exclude=exclude)
    path = np.asarray(path, dtype=float)
    require_path(path, picture, closed=closed)
    course = course_through(path * picture.stretch, closed=closed, sigma=SMOOTH)
    course = _oriented(picture, course, solid)
    located, counted = _located(picture, course, way, exclude, trim)
    return _edge(picture, located, counted, way)


def _located(
    picture: GreyValues, course: SmoothPath, way: EdgeMethod, exclude: Sequence[np.ndarray], trim: float
) -> tuple[Located, Bool[np.ndarray, " normal"]]:
    """Return the edge of the last pass, and the normals that count."""
    for _ in range(way.passes - 1):
        require_room(course)
        clear = _clear(picture, course, exclude)
        located = way.locate(picture, course, clear if exclude else None)
        course = _put_right(replace(located, found=located.found & clear))
    require_room(course)
    share, clear = course.arc / course.arc[-1], _clear(picture, course, exclude)
    counted = clear & ((share >= trim) & (share <= 1 - trim) | course.closed)
    located = way.locate(picture, course, counted)
    return replace(located, found=located.found & clear), counted


def _oriented(picture: GreyValues, course: SmoothPath, solid: str) -> SmoothPath:
    """Return the course in the direction that has the solid on its right."""
    strip = strip_along(picture, course, step=1.0)
    sides = [strip.usable & (side * strip.places > 1.0) for side in (1.0, -1.0)]
    left, right = (float(strip.samples[side].sum()) / max(int(side.sum()), 1) for side in sides)
    return course if (right > left) == (solid == "bright") else course.reversed()


def _clear(picture: GreyValues, course: SmoothPath, exclude: Sequence[np.ndarray]) -> Bool[np.ndarray, " normal"]:
    """Return the normals that start in the picture and whose grey values near the edge are in no excluded polygon."""
    at = course.points / picture.stretch
    clear = ((at >= 0) & (at <= picture.extent - 1)).all(axis=1)
    along = np.stack([-course.normals[:, 1], course.normals[:, 0]], axis=1)
    for place, aside in product(np.linspace(-CLEAR, CLEAR, 9), (-ASIDE, 0.0, ASIDE)) if exclude else ():
        beside = (course.points + place * course.normals + aside * along) / picture.stretch
        for polygon in exclude:
            clear &= ~inside_polygon(beside, np.asarray(polygon, float))
    return np.asarray(clear)


def _put_right(located: Located) -> SmoothPath:
    """Return the smoothed edge: the path for the next pass."""
    course, found = located.course, located.found
    if found.sum() < FEWEST // 3:
        return course
    offsets = np.interp(course.arc, course.arc[found], located.offsets[found])
    middle = median_filter(offsets, min(_NEAR, len(offsets)), mode="wrap" if course.closed else "nearest")
    offsets = np.where(np.abs(offsets - middle) > _STRAY, middle, offsets)
    return smoothed(course.at(offsets), closed=course.closed, sigma=SMOOTH)


def _most_at_limit(found: Located, picture: GreyValues) -> Float[np.ndarray, " 2"] | None:
    """Return the pixel in the middle of the longest stretch at the limit of the strip; None if there is none."""
    at = np.flatnonzero(found.at_limit)
    if not len(at):
        return None
    stretch = max(np.split(at, np.flatnonzero(np.diff(at) > 1) + 1), key=len)
    return np.asarray(found.course.points[stretch[len(stretch) // 2]] / picture.stretch)


def _edge(picture: GreyValues, located: Located, counted: Bool[np.ndarray, " normal"], way: EdgeMethod) -> Edge:
    """Return the points that are kept, with their errors, or refuse them."""
    kept, course, unit = located.found & counted, located.course, picture.unit
    curvatures, normals = _put_right(located).curvatures, course.normals[kept]
    inner = curvatures if course.closed else curvatures[int(2 * SMOOTH) : -int(2 * SMOOTH) or None]
    side = math.sqrt(float(np.mean(((normals * picture.stretch) ** 2).sum(axis=1)))) if kept.any() else 1.0
    found = replace(located, at_limit=located.at_limit & kept)
    errors = edge_errors(found, inner, bias=way.bias, side=side, unit=unit, kept=int(kept.sum()))
    require_edge(int(kept.sum()), errors, unit=unit, limit_at=_most_at_limit(found, picture))
    return Edge(
        points=(located.points / picture.stretch)[kept],
        normals=normals,
        arc=unit * course.arc[kept],
        sds=unit * located.sds[kept],
        errors=errors,
        strip=located.strip,
        offsets=located.offsets,
        kept=kept,
        closed=course.closed and bool(kept.all()),
        method=way,
        unit=unit,
    )
