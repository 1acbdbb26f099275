"""The surface at one grey level of a stack: marching cubes, and the largest connected part of it."""

import importlib
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from strandline.errors import InvalidInput
from strandline.imaging.surfaces.levels import Field
from strandline.imaging.surfaces.mesh import Mesh, vector_areas

__all__ = ["largest_part", "level_surface"]

_FINER, _COARSEST = 4, 3
"""Triangles before the thinning, in those after it; largest step of the grid of cubes, in sides of a voxel."""


def level_surface(field: Field, level: float, *, triangles: int) -> Mesh:
    """Return the surface at a grey level, with normals from bright to dark; lengths in sides of a voxel.

    The outermost voxels, where smoothing lacks neighbours, are left out. The grid is coarser where that leaves several
    times the wanted number of triangles.

    Args:
        field: Smoothed grey values.
        level: Grey value of the surface.
        triangles: Number of triangles that are wanted in the end.

    Raises:
        InvalidInput: scikit-image is missing, or no grey value is on one of the two sides.
    """
    measure = _imported()
    rims = np.maximum(1, np.rint(field.sigma / field.stretch)).astype(int)
    rims = np.where(np.array(field.values.shape[::-1]) > 4 * rims, rims, 0)
    inner = field.values[tuple(slice(rim, -rim or None) for rim in rims[::-1])]
    found = 2 * _crossings(inner > level)
    if found == 0:
        raise InvalidInput(
            "surface in the stack",
            value=f"no voxel on one side of the grey value {level:.6g}",
            expected="a bright and a dark part",
            remedy="Choose the stack, or crop it to the solid and its surroundings.",
        )
    step = next((k for k in range(_COARSEST, 1, -1) if found >= k**2 * _FINER * triangles), 1)
    strides = np.maximum(1, np.rint(step / field.stretch)).astype(int) if step > 1 else np.ones(3, int)
    grid = np.ascontiguousarray(inner[tuple(slice(None, None, stride) for stride in strides[::-1])])
    if min(grid.shape) < 2:
        strides, grid = np.ones(3, int), inner
    points, cells, *_ = measure.marching_cubes(grid, level)
    places = (rims + strides * points[:, ::-1].astype(float)) * field.stretch
    return _merged(places, cells.astype(np.int64)[:, ::-1])


def largest_part(mesh: Mesh) -> tuple[Mesh, float]:
    """Return the connected part with the largest area, and its share of the whole area."""
    one, two = mesh.cells[:, :2].ravel(), mesh.cells[:, 1:].ravel()
    links = coo_array((np.ones(len(one), bool), (one, two)), shape=(len(mesh.points),) * 2)
    _, part = connected_components(links, directed=False)
    areas = np.bincount(part[mesh.cells[:, 0]], np.linalg.norm(vector_areas(mesh.points, mesh.cells), axis=1))
    largest = int(np.argmax(areas))
    return mesh.of_cells(part[mesh.cells[:, 0]] == largest), float(areas[largest] / areas.sum())


def _crossings(bright: np.ndarray) -> int:
    """Return the number of neighbours on different sides: that of the points of the surface on the finest grid."""
    return sum(int(np.count_nonzero(np.diff(bright, axis=axis))) for axis in range(3))


def _merged(points: Float[np.ndarray, "point 3"], cells: Int[np.ndarray, "cell 3"]) -> Mesh:
    """Return the surface without triangles of which two corners coincide."""
    keys = np.rint(points * 2**12).astype(np.int64)
    _, first, number = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    merged = number.ravel()[cells]
    apart = (merged != np.roll(merged, 1, axis=1)).all(axis=1)
    return Mesh(points[first], merged).of_cells(apart)


def _imported() -> Any:
    """Return scikit-image's module of measures.

    Raises:
        InvalidInput: It is not installed.
    """
    try:
        return importlib.import_module("skimage.measure")
    except ModuleNotFoundError:
        raise InvalidInput(
            "a surface from a stack needs scikit-image",
            value="no package of this name",
            expected="the extra `image3d`",
            remedy='Install it: pip install "strandline[image3d]"',
        ) from None
