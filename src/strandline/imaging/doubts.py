"""What makes a picture or a path in it unfit to be used: each refusal is one line."""

import math

import numpy as np
from jaxtyping import Float

from strandline.errors import InvalidInput, InvalidInterface
from strandline.imaging.course import Course
from strandline.imaging.strip import GreyValues
from strandline.interface import Interface

__all__ = ["require_intensity", "require_path", "require_room", "require_speckle"]

_ROOM, _CROSSED = 4.0, 0.05
"""Distance from the path within which normals may not cross, px, but for this share of them."""
_SYMMETRIC = 0.5
"""Skewness over the relative standard deviation below which grey values are no linear intensity: it is 2 for gamma
distributed ones, 1.2 for amplitudes, 0 for a camera's noise and below 0 for logarithms."""


def require_path(path: Float[np.ndarray, "point 2"], picture: GreyValues, *, closed: bool) -> None:
    """Refuse a path that is too short, leaves the picture or crosses itself.

    Raises:
        InvalidInput: It does.
    """
    if path.ndim != 2 or path.shape[1:] != (2,) or len(path) < (3 if closed else 2) or not np.isfinite(path).all():
        raise InvalidInput(
            "path along the edge",
            value=f"an array of shape {path.shape}",
            expected=f"at least {3 if closed else 2} points (x, y), all finite",
            remedy="Give points along the edge in their order, in pixel coordinates.",
        )
    outside = ((path < -0.5) | (path > picture.extent - 0.5)).any(axis=1)
    if outside.any():
        first = int(np.argmax(outside))
        raise InvalidInput(
            "the path leaves the picture",
            value=f"point {first} at ({path[first, 0]:.6g}, {path[first, 1]:.6g}) px",
            expected=f"x up to {picture.extent[0] - 1:.0f} and y up to {picture.extent[1] - 1:.0f} px",
            remedy="Move or remove the point, or choose the picture that the path was made on.",
        )
    apart = np.concatenate([[True], (np.diff(path, axis=0) != 0).any(axis=1)])
    if closed and (path[0] == path[-1]).all():
        apart[-1] = False
    try:
        Interface.polyline(path[apart], closed=closed).require_simple()
    except InvalidInterface as problem:
        raise InvalidInput(
            problem.what.replace("interface", "path"),
            value=str(problem.value).replace(" mm", " px"),
            expected="points in order along the edge, without crossings",
            remedy="Sort the points or remove the loop.",
        ) from None


def require_room(course: Course) -> None:
    """Refuse a path whose normals cross close to it.

    Raises:
        InvalidInput: They do on more than 5 % of its length.
    """
    crossed = ~course.own(np.array([-_ROOM, _ROOM])).all(axis=1)
    if crossed.mean() > _CROSSED:
        raise InvalidInput(
            "normals of the path cross",
            value=f"on {100 * crossed.mean():.0f} % of its length, within {_ROOM:g} px",
            expected=f"bends with radii above {_ROOM:g} px, and no other part of the path nearby",
            remedy="Smooth the path, leave out thin parts, or use a picture with smaller pixels.",
        )


def require_intensity(picture: GreyValues) -> None:
    """Refuse grey values below 0 where linear intensity is meant.

    Raises:
        InvalidInput: There are some.
    """
    least = float(picture.values[picture.usable].min(initial=math.inf))
    if least < 0:
        raise InvalidInput(
            "intensity of the scan",
            value=f"{least:.6g}",
            expected="linear intensity, 0 or above",
            remedy="Undo the logarithm (scale: log10 or dB), or use method `erf`.",
        )


def require_speckle(skewness: float, sd: float) -> None:
    """Refuse grey values that scatter about their mean as no intensity of speckle does.

    Args:
        skewness: Skewness of the values over their mean.
        sd: Standard deviation of the values over their mean.

    Raises:
        InvalidInput: They scatter symmetrically or downwards, like logarithms and the noise of a camera.
    """
    if skewness < _SYMMETRIC * sd:
        raise InvalidInput(
            "grey values of the scan do not scatter like the intensity of speckle: skewness over relative sd",
            value=f"{skewness / sd:.2g}",
            expected="about 2, as linear intensity has; logarithms are below 0",
            remedy="Undo the logarithm of a display scan (scale: log10 or dB); for a camera use method `erf`.",
        )
