"""Regions of a stack in which the surface is not used: boxes and balls."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from strandline.imaging.checked import keys_of, number, unfit, word
from strandline.imaging.pixel_size import UNITS
from strandline.imaging.surfaces.placed import StackFrame, triple

__all__ = ["Region", "region_of"]

Region = Callable[[Float[np.ndarray, "point 3"]], Bool[np.ndarray, " point"]]
"""Points (x, y, z) in voxel coordinates → which of them are left out."""
EXAMPLE = (
    "{box: [[0, 0, 0], [10, 10, 5]], unit: um}, {ball: [5, 5, 0], radius: 2, unit: um} or {voxels: [[0, 0, 0], …]}"
)


@dataclass(frozen=True)
class _Box:
    """A box between two opposite corners.

    Args:
        corners: The corners, shape (2, 3), in mm or, without a frame, in voxels.
        frame: Where the model lies, if the corners are in its coordinates.
    """

    corners: tuple[tuple[float, float, float], tuple[float, float, float]]
    frame: StackFrame | None

    def __call__(self, points: Float[np.ndarray, "point 3"]) -> Bool[np.ndarray, " point"]:
        at = points if self.frame is None else self.frame.to_mm(points)
        corners = np.array(self.corners)
        return np.asarray(((at >= corners.min(axis=0)) & (at <= corners.max(axis=0))).all(axis=1))


@dataclass(frozen=True)
class _Ball:
    """A ball in the model's coordinates, mm."""

    centre: tuple[float, float, float]
    radius: float
    frame: StackFrame

    def __call__(self, points: Float[np.ndarray, "point 3"]) -> Bool[np.ndarray, " point"]:
        away = self.frame.to_mm(points) - np.array(self.centre)
        return np.asarray(np.linalg.norm(away, axis=1) <= self.radius)


def region_of(options: object, place: str, frame: StackFrame) -> Region:
    """Return the region that a study file gives at `place`.

    Args:
        options: A box or a ball in the model's coordinates with a unit, or a box of voxels.
        place: Place in the study file.
        frame: Where the model lies in the stack.

    Raises:
        InvalidInput: Options that are missing, unknown or cannot be used.
    """
    given = keys_of(options, ("box", "ball", "radius", "voxels", "unit"), place, EXAMPLE)
    if set(given) == {"voxels"}:
        return _Box(_corners(given["voxels"], f"{place}.voxels", 1.0), None)
    if set(given) not in ({"box", "unit"}, {"ball", "radius", "unit"}):
        raise unfit(place, dict(given), f"one of {EXAMPLE}")
    mm = UNITS[word(given["unit"], UNITS, f"{place}.unit")]
    if "box" in given:
        return _Box(_corners(given["box"], f"{place}.box", mm), frame)
    x, y, z = (mm * one for one in triple(given["ball"], f"{place}.ball", "the centre [x, y, z] of the ball"))
    return _Ball((x, y, z), mm * _radius(given, place), frame)


def _radius(given: Mapping[str, Any], place: str) -> float:
    return number(given["radius"], f"{place}.radius", "a length above 0", low=5e-324)


def _corners(value: object, place: str, factor: float) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return two opposite corners, times a factor."""
    expected = "two opposite corners [[x, y, z], [x, y, z]]"
    if not (isinstance(value, Sequence) and not isinstance(value, str) and len(value) == 2):
        raise unfit(place, value, expected)
    (a, b, c), (d, e, f) = (triple(one, place, expected) for one in value)
    return (factor * a, factor * b, factor * c), (factor * d, factor * e, factor * f)
