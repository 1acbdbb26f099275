"""A smooth path in a picture, the strip along it, and the edge that a method locates in the strip.

Lengths along a path are in units of the smaller side of a pixel, with x to the right and y down: `GreyValues.stretch`
turns pixel coordinates into them, so that normals and distances are right where pixels are not square.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d, map_coordinates
from scipy.spatial import cKDTree

from strandline.foundations import unfit
from strandline.interface import inside_polygon

PathPoints = Float[np.ndarray, "point 2"]
PerNormal = Float[np.ndarray, " normal"]
PerPlace = Float[np.ndarray, " place"]
Normals = Bool[np.ndarray, " normal"]
Samples = Float[np.ndarray, "normal place"]
_NEARER, _SLACK = 0.85, 1.0
"""A place on a normal belongs to another part of the path if that is nearer than this share of its distance, minus
this slack."""


@dataclass(frozen=True, eq=False)
class SmoothPath:
    """A smooth path of points (x, y) about one pixel apart; if it is closed, the first point follows the last."""

    points: PathPoints
    closed: bool

    @cached_property
    def arc(self) -> Float[np.ndarray, " point"]:
        """Arc length of each point from the first one."""
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.points, axis=0), axis=1))])

    @cached_property
    def tangents(self) -> PathPoints:
        """Unit tangents: those of the chord between the two neighbours."""
        chord = _slope(self.points, self.closed)
        return np.asarray(chord / np.linalg.norm(chord, axis=1, keepdims=True))

    @property
    def normals(self) -> PathPoints:
        """Unit normals to the left of the path as the picture is seen: those of `Interface` once y points up."""
        return np.stack([self.tangents[:, 1], -self.tangents[:, 0]], axis=1)

    @cached_property
    def curvatures(self) -> Float[np.ndarray, " point"]:
        """Curvature 1/R, above 0 where the centre of curvature is on the right as the picture is seen."""
        turn = _slope(self.tangents, self.closed)
        length = np.linalg.norm(_slope(self.points, self.closed), axis=1)
        return np.asarray((self.tangents[:, 0] * turn[:, 1] - self.tangents[:, 1] * turn[:, 0]) / length)

    def reversed(self) -> "SmoothPath":
        """Return the same path in the other direction."""
        return SmoothPath(self.points[::-1].copy(), self.closed)

    def at(self, offsets: Float[np.ndarray, "point ..."]) -> Float[np.ndarray, "..."]:
        """Return places at these distances along the normals, shape (point, ..., 2)."""
        shape = (len(self.points), *([1] * (offsets.ndim - 1)), 2)
        return np.asarray(self.points.reshape(shape) + offsets[..., None] * self.normals.reshape(shape))

    def own(self, offsets: PerPlace) -> Bool[np.ndarray, "point place"]:
        """Return which places along the normals are not clearly nearer to another part of the path.

        Beyond the others normals have crossed: inside a narrow bend, or across a thin part.
        """
        bound = np.maximum(_NEARER * np.abs(offsets) - _SLACK, 0.0)
        places = self.at(np.broadcast_to(offsets, (len(self.points), len(offsets))))
        out = np.ones(places.shape[:2], dtype=bool)
        far = bound > 0
        near, _ = cKDTree(self.points).query(places[:, far], distance_upper_bound=float(bound.max()) + 1.0)
        out[:, far] = near >= bound[far]
        return out


def course_through(points: PathPoints, *, closed: bool, sigma: float) -> SmoothPath:
    """Return the smooth path through points that may be few and far apart, e.g. clicks.

    Between two of them both coordinates are monotone: the path does not bulge.

    `points`: points (x, y), at least two that differ; consecutive equal ones count once. `closed`: whether the path
    returns to its first point. `sigma`: standard deviation of the Gaussian along the path that smooths it.
    """
    around = np.concatenate([points[-3:], points, points[:3]]) if closed else points
    steps = np.linalg.norm(np.diff(around, axis=0), axis=1)
    keep = np.concatenate([[True], steps > 0])
    around = around[keep]
    chord = np.concatenate([[0.0], np.cumsum(steps[steps > 0])])
    if len(around) == 2:
        return _equally_spaced(around, closed=False)
    curve = PchipInterpolator(chord, around)
    first, last = (chord[3], chord[-3]) if closed else (chord[0], chord[-1])
    fine = curve(np.linspace(first, last, max(4 * int(last - first), 64) + 1))
    return smoothed(fine[:-1] if closed else fine, closed=closed, sigma=sigma)


def smoothed(points: PathPoints, *, closed: bool, sigma: float) -> SmoothPath:
    """Return the course along points, convolved along it with a Gaussian; the ends of an open one stay in place."""
    course = _equally_spaced(points, closed=closed).points
    if closed:
        return _equally_spaced(np.asarray(gaussian_filter1d(course, sigma, axis=0, mode="wrap")), closed=True)
    pad = min(len(course) - 1, int(4 * sigma) + 1)  # reflected through the end points, which therefore stay
    before, after = 2 * course[0] - course[pad:0:-1], 2 * course[-1] - course[-2 : -pad - 2 : -1]
    longer = np.concatenate([before, course, after])
    return _equally_spaced(np.asarray(gaussian_filter1d(longer, sigma, axis=0)[pad:-pad]), closed=False)


def _equally_spaced(points: PathPoints, *, closed: bool) -> SmoothPath:
    """Return points one unit apart, as nearly as fits the length."""
    path = np.concatenate([points, points[:1]]) if closed else points
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    places = np.linspace(0.0, arc[-1], max(round(float(arc[-1])), 3) + 1)
    places = places[:-1] if closed else places
    return SmoothPath(np.stack([np.interp(places, arc, path[:, k]) for k in (0, 1)], axis=1), closed)


def _slope(values: PathPoints, closed: bool) -> PathPoints:
    """Return half the difference between the two neighbours of each point, at the ends that to one."""
    if closed:
        return np.asarray(0.5 * (np.roll(values, -1, axis=0) - np.roll(values, 1, axis=0)))
    return np.asarray(np.gradient(values, axis=0))


@dataclass(frozen=True, eq=False)
class GreyValues:
    """Grey values, and which of them count.

    `values`: grey values [row, column]; `usable`: pixels that are finite numbers and not excluded, same shape; `pixel`:
    width and height of a pixel, in any unit of length.
    """

    values: Float[np.ndarray, "row column"]
    usable: Bool[np.ndarray, "row column"]
    pixel: tuple[float, float]

    @property
    def unit(self) -> float:
        """The smaller side of a pixel: the unit of length along a course."""
        return min(self.pixel)

    @property
    def stretch(self) -> Float[np.ndarray, "2"]:
        """Factors that turn pixel coordinates (x, y) into units of the smaller side of a pixel."""
        return np.array(self.pixel) / self.unit

    @property
    def extent(self) -> Float[np.ndarray, "2"]:
        """Number of columns and rows."""
        return np.array(self.values.shape[::-1], dtype=float)


@dataclass(frozen=True, eq=False)
class Strip:
    """Samples of a picture along the normals of a course: grey values, shape (normal, place), 0 where not usable.

    `usable`: samples inside the picture, outside of excluded polygons, and on this side of crossed normals; `places`:
    distances u from the course, shape (place,), above 0 on the left of the path as the picture is seen; `kept`: share
    of the variance of white noise that bilinear interpolation leaves in the samples.
    """

    samples: Samples
    usable: Bool[np.ndarray, "normal place"]
    places: PerPlace
    course: SmoothPath
    kept: float = 1.0

    @property
    def step(self) -> float:
        """Distance between samples on a normal."""
        return float(self.places[1] - self.places[0])


def grey_values(
    values: np.ndarray, *, pixel: tuple[float, float] = (1.0, 1.0), exclude: Sequence[Float[np.ndarray, "_ 2"]] = ()
) -> GreyValues:
    """Return grey values with the pixels that count.

    `values`: grey values [row, column]; those that are not finite do not count. `pixel`: width and height of a pixel,
    in any unit. `exclude`: polygons in pixel coordinates; pixels whose centres they contain do not count.
    """
    values = np.asarray(values)
    if values.ndim != 2 or not (np.issubdtype(values.dtype, np.number) or values.dtype == bool):
        found, remedy = f"shape {values.shape}, {values.dtype}", "Choose one page, and one channel or the mean of them."
        raise unfit("grey values of the picture", found, "numbers [row, column]", remedy)
    if not all(np.isfinite(side) and side > 0 for side in pixel):
        raise unfit("pixel size", list(pixel), "width and height above 0")
    values = values.astype(float)
    usable = np.isfinite(values)
    for polygon in exclude:
        usable &= ~covered_by(np.asarray(polygon, float), values.shape)
    return GreyValues(np.where(np.isfinite(values), values, 0.0), usable, (float(pixel[0]), float(pixel[1])))


def strip_along(picture: GreyValues, course: SmoothPath, *, reach: float = 8.0, step: float = 0.5) -> Strip:
    """Return the picture along the normals of a course, by bilinear interpolation.

    Args:
        picture: The picture.
        course: The path, in units of the smaller side of a pixel.
        reach: Largest distance from the path, in these units.
        step: Distance of the samples, in these units.
    """
    number = round(reach / step)
    places = step * np.arange(-number, number + 1)
    at = course.at(np.broadcast_to(places, (len(course.points), len(places)))) / picture.stretch
    low, high = np.zeros(2), picture.extent - 1
    usable = ((at >= low) & (at <= high)).all(axis=2) & course.own(places)
    where = np.moveaxis(at[..., ::-1], 2, 0)
    samples = map_coordinates(picture.values, where, order=1, mode="nearest")
    if not picture.usable.all():
        usable &= map_coordinates((~picture.usable).astype(float), where, order=1, mode="nearest") < 1e-9
    between = at % 1.0
    kept = float((1 - 2 * between * (1 - between)).prod(axis=2).mean())
    return Strip(np.where(usable, samples, 0.0), usable, places, course, kept)


def covered_by(polygon: Float[np.ndarray, "corner 2"], shape: tuple[int, int]) -> Bool[np.ndarray, "row column"]:
    """Return which pixel centres a polygon contains."""
    covered = np.zeros(shape, dtype=bool)
    if len(polygon) < 3:
        return covered
    low = np.clip(np.floor(polygon.min(axis=0)), 0, shape[::-1]).astype(int)
    high = np.clip(np.ceil(polygon.max(axis=0)) + 1, 0, shape[::-1]).astype(int)
    x, y = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    covered[low[1] : high[1], low[0] : high[0]] = inside_polygon(np.stack([x, y], axis=-1).astype(float), polygon)
    return covered


@dataclass(frozen=True)
class Scatter:
    """Random errors of the points along an edge, in units of the smaller side of a pixel.

    Args:
        sd: Standard deviation s of a point along its normal; not a number before the last pass.
        length: Integral correlation length ℓ = ∫₀^∞ ρ(t) dt along the edge; likewise.
    """

    sd: float = math.nan
    length: float = math.nan


@dataclass(frozen=True, eq=False)
class Located:
    """An edge along the normals of a course; lengths in units of the smaller side of a pixel.

    Args:
        strip: The samples on which it was found.
        offsets: Distance of the edge from the course along each normal, shape (normal,).
        sds: Standard deviation of each, shape (normal,).
        found: Normals on which the edge could be found.
        at_limit: Normals on which it lies at the limit of the strip.
        scatter: Random errors of the points, from this picture.
        blur: Standard deviation of the blur across the edge.
        contrast: Grey value on the left of the path minus that on its right.
        contrast_to_noise: Size of the contrast over the standard deviation of the noise; see the method.
        facts: What else the method estimated, by name.
    """

    strip: Strip
    offsets: PerNormal
    sds: PerNormal
    found: Normals
    at_limit: Normals
    scatter: Scatter
    blur: float
    contrast: float
    contrast_to_noise: float
    facts: dict[str, float]

    @property
    def course(self) -> SmoothPath:
        """The path along whose normals the edge was found."""
        return self.strip.course

    @property
    def points(self) -> Float[np.ndarray, "normal 2"]:
        """The points of the edge, neither smoothed nor selected."""
        return self.course.at(self.offsets)


@runtime_checkable
class EdgeMethod(Protocol):
    """A way to find an edge near a path."""

    @property
    def bias(self) -> float:
        """Standard deviation of a common offset of the edge, in pixels, where the edge is straight; above 0."""
        ...

    @property
    def passes(self) -> int:
        """Number of times the edge is looked for: from the second time on, near the edge found before."""
        ...

    def locate(self, picture: GreyValues, course: SmoothPath, counted: Normals | None) -> Located:
        """Return the edge near a course.

        Args:
            picture: The picture.
            course: The path, in units of the smaller side of a pixel, with the solid on its right.
            counted: Normals whose points are kept, from which errors are estimated; None before the last pass, when
                no errors are needed.
        """
        ...
