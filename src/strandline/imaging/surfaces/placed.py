"""Voxel coordinates ↔ coordinates of the model, in mm."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.imaging.checked import keys_of, number, unfit, word
from strandline.imaging.surfaces.mesh import Mesh
from strandline.interface import Interface

__all__ = ["StackFrame", "triple"]

SIGNS: dict[str, dict[str, float]] = {
    "x": {"right": 1.0, "left": -1.0},
    "y": {"down": 1.0, "up": -1.0},
    "z": {"last": 1.0, "first": -1.0},
}
"""Axis of the model → where it points in the stack → its sign."""
EXAMPLE = "{origin: [128, 128, 64], y: down, z: last}"


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
        given = keys_of(options, CHECKS, place, EXAMPLE)
        if given.get("origin") is None:
            raise unfit(f"{place}.origin", None, "the voxel [x, y, z] of the model's (0, 0, 0)", f"Add it: {EXAMPLE}.")
        values = {name: CHECKS[name](value, f"{place}.{name}") for name, value in given.items() if value is not None}
        return cls(voxel=voxel, **values)

    @property
    def matrix(self) -> Float[np.ndarray, "3 3"]:
        """Matrix that turns differences of voxel coordinates into differences of model coordinates, mm."""
        signs = np.array([SIGNS[name][getattr(self, name)] for name in SIGNS])
        return np.asarray(_turned(self.rotation).T * (signs * self.voxel))

    def to_mm(self, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point 3"]:
        """Return points given in voxels as points of the model, mm.

        Args:
            points: Voxel coordinates (x, y, z), shape (point, 3).
        """
        return np.asarray((points - np.array(self.origin)) @ self.matrix.T)

    def interface(self, mesh: Mesh) -> Interface:
        """Return a surface in voxel coordinates as an interface of the model, with normals out of the solid."""
        mirrored = np.linalg.det(self.matrix) < 0
        cells = mesh.cells[:, ::-1] if mirrored else mesh.cells
        return Interface(self.to_mm(mesh.points), np.ascontiguousarray(cells))


def _turned(rotation: tuple[float, float, float]) -> Float[np.ndarray, "3 3"]:
    """Return the matrix that turns about x, then y, then z, by angles in degrees."""
    out = np.eye(3)
    for axis, angle in enumerate(np.deg2rad(rotation)):
        c, s, one = math.cos(angle), math.sin(angle), np.eye(3)
        a, b = (axis + 1) % 3, (axis + 2) % 3
        one[a, a], one[a, b], one[b, a], one[b, b] = c, -s, s, c
        out = one @ out
    return out


def triple(value: object, place: str, expected: str, limit: float = math.inf) -> tuple[float, float, float]:
    """Return three finite numbers, at most `limit` in size.

    Raises:
        InvalidInput: It is another value; `expected` says what would be correct.
    """
    if not (isinstance(value, list | tuple) and len(value) == 3):
        raise unfit(place, value, expected)
    x, y, z = (number(one, place, expected, -limit, limit) for one in value)
    return x, y, z


CHECKS: dict[str, Callable[[Any, str], Any]] = {
    "origin": lambda value, place: triple(value, place, "the voxel [x, y, z] of the model's (0, 0, 0)"),
    "x": lambda value, place: word(value, SIGNS["x"], place),
    "y": lambda value, place: word(value, SIGNS["y"], place),
    "z": lambda value, place: word(value, SIGNS["z"], place),
    "rotation": lambda value, place: triple(
        value, place, "angles [x, y, z] from -360 to 360 degrees, about the axes of the model", 360.0
    ),
}
"""Option → check (value, place) that returns the value."""
