"""Voxel coordinates ↔ coordinates of the model, in mm, and regions of a stack in which the surface is not used."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from strandline.imaging.frame import frame_options
from strandline.imaging.reading import UNITS
from strandline.imaging.surfaces.mesh import Mesh
from strandline.interface import Interface
from strandline.readers.checked import keys_of, number, numbers, unfit, word

SIGNS: dict[str, dict[str, float]] = {
    "x": {"right": 1.0, "left": -1.0},
    "y": {"down": 1.0, "up": -1.0},
    "z": {"last": 1.0, "first": -1.0},
}
"""Axis of the model → where it points in the stack → its sign."""
ORIGIN = "the voxel [x, y, z] of the model's (0, 0, 0)"
ANGLES = "angles [x, y, z] from -360 to 360 degrees, about the axes of the model"
EXAMPLE = "{origin: [128, 128, 64], y: down, z: last}"
Region = Callable[[Float[np.ndarray, "point 3"]], Bool[np.ndarray, " point"]]
"""Points (x, y, z) in voxel coordinates → which of them are left out."""
REGIONS = (
    "{box: [[0, 0, 0], [10, 10, 5]], unit: um}, {ball: [5, 5, 0], radius: 2, unit: um} or {voxels: [[0, 0, 0], …]}"
)


@dataclass(frozen=True)
class StackFrame:
    """Where the model lies in a stack.

    A point m of the model, in mm, appears at the voxel origin + S R m / voxel: R turns the model about its x axis, then
    about y, then about z, and S = diag(±1, ±1, ±1) points the axes as `x`, `y` and `z` say.

    Args:
        origin: Voxel (x, y, z) of the model's (0, 0, 0); the centre of the first voxel is (0, 0, 0).
        voxel: Size of a voxel along x, y and z, mm.
        x: Direction of the model's x axis in the stack, ``right`` or ``left``.
        y: Direction of its y axis, ``down`` or ``up``.
        z: Direction of its z axis, towards the ``last`` plane or the ``first``.
        rotation: Angles by which the model is turned in the stack about its x, y and z axes, in this order, degrees;
            that about z from x towards y, that about x from y towards z, that about y from z towards x.

    Raises:
        InvalidInput: A direction that does not exist, or another number that is not finite.
    """

    origin: tuple[float, float, float]
    voxel: tuple[float, float, float]
    x: str = "right"
    y: str = "down"
    z: str = "last"
    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name, check in CHECKS.items():
            check(getattr(self, name), f"frame.{name}")

    @classmethod
    def from_options(cls, options: object, place: str, *, voxel: tuple[float, float, float]) -> "StackFrame":
        """Return the frame that a study file gives at `place`, for a stack with this size of a voxel, mm.

        Raises:
            InvalidInput: An option is missing, unknown or cannot be used.
        """
        return cls(voxel=voxel, **frame_options(options, CHECKS, place, ORIGIN, EXAMPLE))

    @property
    def matrix(self) -> Float[np.ndarray, "3 3"]:
        """Matrix that turns differences of voxel coordinates into differences of model coordinates, mm."""
        signs = np.array([SIGNS[name][getattr(self, name)] for name in SIGNS])
        turned = Rotation.from_euler("xyz", self.rotation, degrees=True).as_matrix()
        return np.asarray(turned.T * (signs * self.voxel))

    def to_mm(self, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point 3"]:
        """Return voxel coordinates (x, y, z), shape (point, 3), as points of the model, mm."""
        return np.asarray((points - np.array(self.origin)) @ self.matrix.T)

    def interface(self, mesh: Mesh) -> Interface:
        """Return a surface in voxel coordinates as an interface of the model, with normals out of the solid."""
        mirrored = np.linalg.det(self.matrix) < 0
        cells = mesh.cells[:, ::-1] if mirrored else mesh.cells
        return Interface(self.to_mm(mesh.points), np.ascontiguousarray(cells))


CHECKS: dict[str, Callable[[Any, str], Any]] = {
    "origin": lambda value, place: numbers(value, 3, place, ORIGIN),
    "x": lambda value, place: word(value, SIGNS["x"], place),
    "y": lambda value, place: word(value, SIGNS["y"], place),
    "z": lambda value, place: word(value, SIGNS["z"], place),
    "rotation": lambda value, place: numbers(value, 3, place, ANGLES, 360.0),
}
"""Option → check (value, place) that returns the value."""


def region_of(options: object, place: str, frame: StackFrame) -> Region:
    """Return the region that a study file gives at `place`.

    Args:
        options: A box or a ball in the model's coordinates with a unit, or a box of voxels.
        place: Place in the study file.
        frame: Where the model lies in the stack.

    Raises:
        InvalidInput: Options that are missing, unknown or cannot be used.
    """
    given = keys_of(options, ("box", "ball", "radius", "voxels", "unit"), place, REGIONS)
    if set(given) == {"voxels"}:
        return partial(_in_box, corners=_corners(given["voxels"], f"{place}.voxels"), frame=None)
    if set(given) not in ({"box", "unit"}, {"ball", "radius", "unit"}):
        raise unfit(place, dict(given), f"one of {REGIONS}")
    mm = UNITS[word(given["unit"], UNITS, f"{place}.unit")]
    if "box" in given:
        return partial(_in_box, corners=mm * _corners(given["box"], f"{place}.box"), frame=frame)
    centre = mm * np.array(numbers(given["ball"], 3, f"{place}.ball", "the centre [x, y, z] of the ball"))
    radius = mm * number(given["radius"], f"{place}.radius", "a length above 0", low=5e-324)
    return partial(_in_ball, centre=centre, radius=radius, frame=frame)


def _in_box(
    points: Float[np.ndarray, "point 3"], corners: Float[np.ndarray, "2 3"], frame: StackFrame | None
) -> Bool[np.ndarray, " point"]:
    """Return which points lie between two opposite corners, in mm or, without a frame, in voxels."""
    at = points if frame is None else frame.to_mm(points)
    return np.asarray(((at >= corners.min(axis=0)) & (at <= corners.max(axis=0))).all(axis=1))


def _in_ball(
    points: Float[np.ndarray, "point 3"], centre: Float[np.ndarray, " 3"], radius: float, frame: StackFrame
) -> Bool[np.ndarray, " point"]:
    return np.asarray(np.linalg.norm(frame.to_mm(points) - centre, axis=1) <= radius)


def _corners(value: object, place: str) -> Float[np.ndarray, "2 3"]:
    """Return two opposite corners."""
    expected = "two opposite corners [[x, y, z], [x, y, z]]"
    if not (isinstance(value, Sequence) and not isinstance(value, str) and len(value) == 2):
        raise unfit(place, value, expected)
    return np.array([numbers(one, 3, place, expected) for one in value])
