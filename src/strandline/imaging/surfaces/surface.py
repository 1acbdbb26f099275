"""The surface of a solid in a stack of pictures, sub-voxel, with its errors; where the model lies in the stack."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from strandline.foundations import number, numbers, unfit
from strandline.imaging.picture import UNITS, Stack
from strandline.imaging.surfaces.mesh import Field, Mesh, Points, field_of, largest_part, level_surface, thinned
from strandline.imaging.surfaces.profiles import (
    Profiles,
    SurfaceErrors,
    blur_along_axes,
    dislocation,
    noise_beside,
    normals_of,
    profiles_at,
    require_surface,
    shape_operators,
    surface_errors,
)
from strandline.interface import Interface, vector_areas

SIGNS = {"x": {"right": 1.0, "left": -1.0}, "y": {"down": 1.0, "up": -1.0}, "z": {"last": 1.0, "first": -1.0}}
"""Axis of the model → where it points in the stack → its sign."""
ANGLES = "angles [x, y, z] from -360 to 360 degrees, about the axes of the model"
Point = tuple[float, float, float]
Region = Callable[[Points], Bool[np.ndarray, " point"]]
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

    def to_mm(self, points: Points) -> Points:
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

    def _holds(self, points: Points, frame: StackFrame) -> Bool[np.ndarray, " point"]:
        mm = UNITS[self.unit] if self.unit else 1.0
        at = points if self.voxels is not None else frame.to_mm(points)
        if self.ball is not None:
            return np.asarray(np.linalg.norm(at - mm * np.array(self.ball), axis=1) <= mm * float(self.radius or 0.0))
        corners = mm * np.array(self.voxels or self.box)
        return np.asarray(((at >= corners.min(axis=0)) & (at <= corners.max(axis=0))).all(axis=1))


PASSES = 3
FEWEST, FEWEST_LEFT = 100, 10
"""Fewest triangles of a surface, and of what is left of it beside the regions to exclude."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A surface in a stack.

    Args:
        mesh: Triangles in voxel coordinates (x, y, z) = (column, row, plane), the centre of the first voxel at
            (0, 0, 0). Seen from outside of the solid their corners run counter-clockwise, if the axes are right-handed.
        errors: Errors that the stack shows.
        left_out: Number of triangles that were left out because a corner lies in a region to exclude.
    """

    mesh: Mesh
    errors: SurfaceErrors
    left_out: int = 0

    def __repr__(self) -> str:
        e = self.errors
        return (
            f"Surface({len(self.mesh.cells)} triangles, sd {e.sd:.3g} mm, length {e.length:.3g} mm, "
            f"offset {e.offset:.3g} mm, contrast/noise {e.contrast_to_noise:.3g})"
        )


def find_surface(
    stack: Stack, *, solid: str, triangles: int = 5000, smooth: float | None = None, exclude: Sequence[Region] = ()
) -> Surface:
    """Return the surface of the solid in a stack: the largest connected one.

    Marching cubes (Lorensen and Cline 1987) find it, it is thinned, and each corner moves along its normal to where the
    grey value is half way between those of the two sides nearby.

    Args:
        stack: The stack.
        solid: ``bright`` or ``dark``: the side of the solid; this sets the direction of the normals.
        triangles: Most triangles.
        smooth: Standard deviation of the Gaussian that smooths the stack, in sides of a cube with a voxel's volume; by
            default 1, and up to 2 in a noisy stack.
        exclude: Regions; triangles with a corner in one of them are left out.

    Raises:
        InvalidInput: scikit-image is missing, or the stack says too little about the surface; see
            `require_surface`.
    """
    if solid not in ("bright", "dark"):
        raise unfit("side of the solid", solid, "bright or dark", "Choose one of them.")
    if triangles < FEWEST:
        raise unfit("most triangles", triangles, f"at least {FEWEST}", "Use 5000.")
    unit = float(np.prod(stack.voxel)) ** (1 / 3)
    field = field_of(stack.values, np.array(stack.voxel) / unit, smooth=smooth)
    level = field.level
    mesh, share = largest_part(level_surface(field, level, triangles=triangles))
    mesh = thinned(mesh, triangles)
    if len(mesh.cells) < FEWEST:
        remedy = "Use a stack with smaller voxels, or ask for more `triangles`."
        raise unfit("number of triangles of the surface", len(mesh.cells), f"at least {FEWEST}", remedy)
    mesh, normals, profiles = _refined(field, mesh, level, bright=solid == "bright")
    variances = blur_along_axes(profiles.blurs, normals)
    moved = dislocation(shape_operators(mesh.points, normals), variances)
    cut = _cut_share(field, mesh, level, bright=solid == "bright")
    number = len(mesh.cells)
    used, mesh = _outside(mesh, exclude, field.stretch)
    normals, moved, profiles = normals[used], moved[used], profiles.of(used)
    noise = noise_beside(field, mesh, normals, profiles)
    mesh = Mesh(mesh.points + moved[:, None] * normals, mesh.cells)
    errors = surface_errors(field, mesh, profiles, noise, moved, unit, cut, share)
    require_surface(errors, 1 - float(profiles.found.mean()))
    return Surface(Mesh(mesh.points / field.stretch, mesh.cells), errors, number - len(mesh.cells))


def _outside(
    mesh: Mesh, exclude: Sequence[Region], stretch: Float[np.ndarray, " 3"]
) -> tuple[Int[np.ndarray, " used"], Mesh]:
    """Return the numbers of the points, and the triangles, without a corner in a region to exclude."""
    if not exclude:
        return np.arange(len(mesh.points)), mesh
    inside = np.zeros(len(mesh.points), dtype=bool)
    for region in exclude:
        inside |= region(mesh.points / stretch)
    kept = ~inside[mesh.cells].any(axis=1)
    if kept.sum() < FEWEST_LEFT:
        what = "number of triangles outside of the regions to exclude"
        remedy = "Exclude less, and check the frame in whose coordinates the regions are given."
        raise unfit(what, int(kept.sum()), f"at least {FEWEST_LEFT}", remedy)
    return np.unique(mesh.cells[kept]), mesh.of_cells(kept)


def _refined(field: Field, mesh: Mesh, level: float, *, bright: bool) -> tuple[Mesh, Points, Profiles]:
    """Return the surface with its points at the half level, its normals out of the solid, and the last profiles."""
    for _ in range(PASSES):
        normals = normals_of(field, mesh.points, bright=bright)
        profiles = profiles_at(field, mesh, normals, level=level)
        mesh = Mesh(mesh.points + profiles.offsets[:, None] * normals, mesh.cells)
    areas = vector_areas(mesh.points, mesh.cells)
    if float((areas * normals[mesh.cells].sum(axis=1)).sum()) < 0:
        mesh = Mesh(mesh.points, mesh.cells[:, ::-1].copy())
    return mesh, normals, profiles


def _cut_share(field: Field, mesh: Mesh, level: float, *, bright: bool) -> float:
    """Return the share of the solid's surface that lies on the faces of the stack, 0 if the surface has no rim."""
    if not mesh.on_rim.any():
        return 0.0
    solid, cut = (field.values > level) == bright, 0.0
    for axis in range(3):
        face = float(np.prod(np.delete(field.stretch, 2 - axis)))
        cut += face * sum(int(np.count_nonzero(solid.take(end, axis=axis))) for end in (0, -1))
    own = float(mesh.areas.sum())
    return cut / (cut + own)
