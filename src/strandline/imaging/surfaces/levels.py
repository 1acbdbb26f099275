"""Grey values of a stack, smoothed, and the surface at one level of them: marching cubes."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int
from scipy.ndimage import gaussian_filter
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from strandline.foundations import of_extra
from strandline.imaging.surfaces.mesh import Mesh
from strandline.readers import unfit

Voxels = Float32[np.ndarray, "z row column"]
_BINS = 256
_NEEDS = "a surface from a stack needs scikit-image"
_EVERY = 1 << 20
"""Voxels from which the two levels and the noise come; of larger stacks every so many are taken."""
_NORMAL = 0.6745
"""Median of the size of a standard normal number."""
_CLEAN, _SMOOTHEST = 5.0, 2.0
"""Contrast over noise from which a Gaussian of 1 is enough; largest Gaussian, in sides of a voxel."""
_TRUNCATE = 3.0
_FINER, _COARSEST = 4, 3
"""Triangles before the thinning, in those after it; largest step of the grid of cubes, in sides of a voxel."""


@dataclass(frozen=True, eq=False)
class Field:
    """The smoothed grey values of a stack.

    Lengths are in sides of a cube with a voxel's volume, so that a voxel need not be a cube.

    `values`: smoothed grey values, shape (z, row, column); `raw`: grey values as read, of the same shape; `stretch`:
    size of a voxel along x, y and z; `sigma`: standard deviation of the Gaussian that smoothed them.
    """

    values: Voxels
    raw: Float[np.ndarray, "z row column"]
    stretch: Float[np.ndarray, " 3"]
    sigma: float

    @property
    def extent(self) -> Float[np.ndarray, " 3"]:
        """Place (x, y, z) of the last voxel; that of the first is 0."""
        return np.asarray((np.array(self.values.shape[::-1]) - 1) * self.stretch)


def field_of(
    values: Float[np.ndarray, "z row column"], stretch: Float[np.ndarray, " 3"], *, smooth: float | None
) -> Field:
    """Return the smoothed grey values for voxels of a size along x, y and z.

    `smooth` is the standard deviation of the Gaussian, in sides of a voxel; by default 1, and up to 2 in a noisy stack.
    """
    single = values.astype(np.float32)
    sigma = 1.0 if smooth is None else smooth
    smoothed = _blurred(single, sigma, stretch)
    if smooth is None:
        low, high = two_levels(smoothed)
        wanted = min(_CLEAN * _noise(single) / max(high - low, 1e-30), _SMOOTHEST)
        if wanted > sigma:
            smoothed, sigma = _blurred(smoothed, math.sqrt(wanted**2 - sigma**2), stretch), wanted
    return Field(smoothed, values, stretch, sigma)


def two_levels(values: Voxels) -> tuple[float, float]:
    """Return the median grey values of the dark and of the bright part, told apart by Otsu's threshold (1979)."""
    some = _some(values)
    if some.min() == some.max():
        return float(some[0]), float(some[0])
    counts, edges = np.histogram(some, _BINS)
    threshold = of_extra("skimage.filters", "image3d", _NEEDS).threshold_otsu(hist=(counts, edges[1:]))
    dark, bright = some[some <= threshold], some[some > threshold]
    return float(np.median(dark)), float(np.median(bright))


def _noise(values: Voxels) -> float:
    """Return the standard deviation of white noise, from differences of neighbours along a row."""
    step = max(1, round((values.size / _EVERY) ** (1 / 2)))
    difference = np.diff(values[::step, ::step], axis=2)
    return float(np.median(np.abs(difference))) / (_NORMAL * math.sqrt(2))


def _some(values: Voxels) -> Float32[np.ndarray, " some"]:
    step = max(1, round((values.size / _EVERY) ** (1 / 3)))
    return values[::step, ::step, ::step].ravel()


def _blurred(values: Voxels, sigma: float, stretch: Float[np.ndarray, " 3"]) -> Voxels:
    return np.asarray(gaussian_filter(values, sigma / stretch[::-1], mode="nearest", truncate=_TRUNCATE))


def level_surface(field: Field, level: float, *, triangles: int) -> Mesh:
    """Return the surface at a grey level, with normals from bright to dark; lengths in sides of a voxel.

    The outermost voxels, where smoothing lacks neighbours, are left out. The grid is coarser where that leaves several
    times the number of triangles that are wanted in the end.
    """
    measure = of_extra("skimage.measure", "image3d", _NEEDS)
    rims = np.maximum(1, np.rint(field.sigma / field.stretch)).astype(int)
    rims = np.where(np.array(field.values.shape[::-1]) > 4 * rims, rims, 0)
    inner = field.values[tuple(slice(rim, -rim or None) for rim in rims[::-1])]
    found = 2 * _crossings(inner > level)
    if found == 0:
        value, expected = f"no voxel on one side of the grey value {level:.6g}", "a bright and a dark part"
        remedy = "Choose the stack, or crop it to the solid and its surroundings."
        raise unfit("surface in the stack", value, expected, remedy)
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
    areas = np.bincount(part[mesh.cells[:, 0]], mesh.areas)
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
