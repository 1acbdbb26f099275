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

__all__ = ["StackFrame"]

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

    Args:
        origin: Voxel (x, y, z) of the model's (0, 0, 0); the centre of the first voxel is (0, 0, 0).
        voxel: Size of a voxel along x, y and z, mm.
        x: Direction of the model's x axis in the stack, ``right`` or ``left``.
        y: Direction of its y axis, ``down`` or ``up``.
        z: Direction of its z axis, towards the ``last`` plane or the ``first``.

    Raises:
        InvalidInput: A direction that does not exist, or another number that is not finite.
    """

    origin: tuple[float, float, float]
    voxel: tuple[float, float, float]
    x: str = "right"
    y: str = "down"
    z: str = "last"

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
    def scale(self) -> Float[np.ndarray, " 3"]:
        """Change of the model's coordinates per voxel, mm."""
        return np.array([SIGNS[name][getattr(self, name)] for name in SIGNS]) * self.voxel

    def interface(self, mesh: Mesh) -> Interface:
        """Return a surface in voxel coordinates as an interface of the model, with normals out of the solid."""
        mirrored = math.prod(self.scale) < 0
        cells = mesh.cells[:, ::-1] if mirrored else mesh.cells
        return Interface((mesh.points - np.array(self.origin)) * self.scale, np.ascontiguousarray(cells))


def _origin(value: object, place: str) -> tuple[float, float, float]:
    expected = "the voxel [x, y, z] of the model's (0, 0, 0)"
    if not (isinstance(value, list | tuple) and len(value) == 3):
        raise unfit(place, value, expected)
    x, y, z = (number(one, place, expected) for one in value)
    return x, y, z


CHECKS: dict[str, Callable[[Any, str], Any]] = {
    "origin": _origin,
    "x": lambda value, place: word(value, SIGNS["x"], place),
    "y": lambda value, place: word(value, SIGNS["y"], place),
    "z": lambda value, place: word(value, SIGNS["z"], place),
}
"""Option → check (value, place) that returns the value."""
