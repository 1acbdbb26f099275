"""The strip: a picture sampled along the normals of a path."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import map_coordinates

from strandline.imaging.course import SmoothPath
from strandline.readers.checked import unfit


@dataclass(frozen=True, eq=False)
class GreyValues:
    """Grey values, and which of them count.

    Args:
        values: Grey values [row, column].
        usable: Pixels that are finite numbers and not excluded, same shape.
        pixel: Width and height of a pixel, in any unit of length.
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
    """Samples of a picture along the normals of a course.

    Args:
        samples: Grey values, shape (normal, place); 0 where not usable.
        usable: Samples inside the picture, outside of excluded polygons, and on this side of crossed normals.
        places: Distances u from the course, shape (place,), above 0 on the left of the path as the picture is seen.
        course: The path.
        kept: Share of the variance of white noise that bilinear interpolation leaves in the samples.
    """

    samples: Float[np.ndarray, "normal place"]
    usable: Bool[np.ndarray, "normal place"]
    places: Float[np.ndarray, " place"]
    course: SmoothPath
    kept: float = 1.0

    @property
    def step(self) -> float:
        """Distance between samples on a normal."""
        return float(self.places[1] - self.places[0])


def grey_values(
    values: np.ndarray,
    *,
    pixel: tuple[float, float] = (1.0, 1.0),
    exclude: Sequence[Float[np.ndarray, "_ 2"]] = (),
) -> GreyValues:
    """Return grey values with the pixels that count.

    Args:
        values: Grey values [row, column]; those that are not finite do not count.
        pixel: Width and height of a pixel, in any unit.
        exclude: Polygons in pixel coordinates; pixels whose centres they contain do not count.
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


def strip_along(
    picture: GreyValues, course: SmoothPath, *, reach: float = 8.0, step: float = 0.5, order: int = 1
) -> Strip:
    """Return the picture along the normals of a course.

    Args:
        picture: The picture.
        course: The path, in units of the smaller side of a pixel.
        reach: Largest distance from the path, in these units.
        step: Distance of the samples, in these units.
        order: Order of the interpolation: 1 is bilinear, 3 that of cubic splines.
    """
    number = round(reach / step)
    places = step * np.arange(-number, number + 1)
    at = course.at(np.broadcast_to(places, (len(course.points), len(places)))) / picture.stretch
    low, high = np.zeros(2), picture.extent - 1
    usable = ((at >= low) & (at <= high)).all(axis=2) & course.own(places)
    where = np.moveaxis(at[..., ::-1], 2, 0)
    samples = map_coordinates(picture.values, where, order=order, mode="nearest")
    if not picture.usable.all():
        usable &= map_coordinates((~picture.usable).astype(float), where, order=1, mode="nearest") < 1e-9
    between = at % 1.0
    kept = float((1 - 2 * between * (1 - between)).prod(axis=2).mean()) if order == 1 else 1.0
    return Strip(np.where(usable, samples, 0.0), usable, places, course, kept)


def inside_polygon(points: Float[np.ndarray, "*point 2"], polygon: Float[np.ndarray, "corner 2"]) -> np.ndarray:
    """Return which points a polygon contains, by the number of its sides to the right of each; any shape (..., 2)."""
    inside = np.zeros(points.shape[:-1], dtype=bool)
    x, y = points[..., 0], points[..., 1]
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if a[1] != b[1]:
            spans = (a[1] > y) != (b[1] > y)
            inside ^= spans & (x < a[0] + (y - a[1]) * (b[0] - a[0]) / (b[1] - a[1]))
    return inside


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
