"""The surface of a solid in a stack of pictures, sub-voxel, with its errors."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from strandline.imaging.picture import Stack
from strandline.imaging.surfaces.levels import Field, field_of, largest_part, level_surface, two_levels
from strandline.imaging.surfaces.mesh import Mesh, thinned
from strandline.imaging.surfaces.profiles import (
    Profiles,
    blur_along_axes,
    dislocation,
    normals_of,
    profiles_at,
    shape_operators,
)
from strandline.imaging.surfaces.stack_frame import Region
from strandline.imaging.surfaces.surface_errors import (
    SurfaceErrors,
    noise_beside,
    require_surface,
    surface_errors,
)
from strandline.interface.triangles import vector_areas
from strandline.readers.checked import unfit

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
    stack: Stack,
    *,
    solid: str,
    triangles: int = 5000,
    smooth: float | None = None,
    exclude: Sequence[Region] = (),
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
    level = 0.5 * sum(two_levels(field.values))
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
    errors = surface_errors(field, mesh, profiles, noise, moved, unit=unit, open_share=cut, area_share=share)
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


def _refined(
    field: Field, mesh: Mesh, level: float, *, bright: bool
) -> tuple[Mesh, Float[np.ndarray, "point 3"], Profiles]:
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
