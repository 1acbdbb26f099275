"""Voxel coordinates ↔ coordinates of the model, in mm, and regions of a stack in which the surface is not used."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from strandline.imaging.reading import UNITS
from strandline.imaging.surfaces.mesh import Mesh
from strandline.interface import Interface
from strandline.readers.checked import number, numbers, unfit

SIGNS: dict[str, dict[str, float]] = {
    "x": {"right": 1.0, "left": -1.0},
    "y": {"down": 1.0, "up": -1.0},
    "z": {"last": 1.0, "first": -1.0},
}
"""Axis of the model → where it points in the stack → its sign."""
ANGLES = "angles [x, y, z] from -360 to 360 degrees, about the axes of the model"
Point = tuple[float, float, float]
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
        InvalidInput: A number that is not finite, or out of its range.
    """

    origin: tuple[float, float, float]
    voxel: tuple[float, float, float]
    x: Literal["right", "left"] = "right"
    y: Literal["down", "up"] = "down"
    z: Literal["last", "first"] = "last"
    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        numbers(self.origin, 3, "origin", "the voxel [x, y, z] of the model's (0, 0, 0)")
        numbers(self.rotation, 3, "rotation", ANGLES, 360.0)

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


@dataclass(frozen=True)
class StatedRegion:
    """A region as a study states it: a box or a ball in the model's coordinates with a unit, or a box of voxels.

    Args:
        box: Two opposite corners, in `unit`.
        ball: Centre of a ball, in `unit`.
        radius: Radius of the ball, in `unit`.
        voxels: Two opposite corners, in voxels.
        unit: Unit of length.

    Raises:
        InvalidInput: Options that do not fit together.
    """

    box: tuple[Point, Point] | None = None
    ball: Point | None = None
    radius: float | None = None
    voxels: tuple[Point, Point] | None = None
    unit: Literal["nm", "um", "µm", "mm", "m"] | None = None

    def __post_init__(self) -> None:
        stated = {f.name for f in fields(self) if getattr(self, f.name) is not None}
        if stated not in ({"voxels"}, {"box", "unit"}, {"ball", "radius", "unit"}):
            raise unfit("region of a stack", ", ".join(sorted(stated)) or None, f"one of {REGIONS}")
        if self.radius is not None:
            number(self.radius, "radius", "a length above 0", low=5e-324)

    def within(self, frame: StackFrame) -> Region:
        """Return the region in voxels of a stack in which the model lies as `frame` says."""
        return partial(self._holds, frame=frame)

    def _holds(self, points: Float[np.ndarray, "point 3"], frame: StackFrame) -> Bool[np.ndarray, " point"]:
        """Return which points, in voxels, lie in the region."""
        mm = UNITS[self.unit] if self.unit else 1.0
        at = points if self.voxels is not None else frame.to_mm(points)
        if self.ball is not None:
            return np.asarray(np.linalg.norm(at - mm * np.array(self.ball), axis=1) <= mm * float(self.radius or 0.0))
        corners = mm * np.array(self.voxels or self.box)
        return np.asarray(((at >= corners.min(axis=0)) & (at <= corners.max(axis=0))).all(axis=1))
