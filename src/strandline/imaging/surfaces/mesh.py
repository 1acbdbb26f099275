"""Triangles while they are worked on: at one level of a stack's smoothed grey values, and how they become fewer.

They have no checks of an interface yet. Sides collapse where that moves the surface least. The error of a collapse is
the sum of the squared distances to the planes of the triangles that went into its two ends (Garland and Heckbert 1997).
Many sides collapse at a time, so far from each other that none sees another one, and only where the surface stays one
without folds.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from scipy.ndimage import gaussian_filter
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from strandline.foundations import of_extra, unfit
from strandline.interface import triangle_sides, vector_areas

Points = Float[np.ndarray, "point 3"]
PerPoint = Float[np.ndarray, " point"]
Sides = Int[np.ndarray, "edge 2"]
Places = Float[np.ndarray, "edge 3"]
Lengths = Float[np.ndarray, " 3"]
_ROUNDS, _CHEAPEST = 400, 0.4
"""Most rounds, and the share of the sides, the cheapest, of which some collapse in each."""
_STUCK, _SIMPLEX = 5, 4
"""Rounds without a collapse after which there is none; points of a surface that cannot be simpler."""
_EVEN = 1e-2
"""Weight of the length of a side, which keeps triangles even where the surface is flat or noisy."""
_TURNED = 0.3
"""Least cosine between the normals of a triangle before and after."""
_THIN = 0.1
"""Least area over the square of the longest side of the triangles at a collapse, unless one was thinner before it."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles in space.

    `points`: corners (x, y, z), shape (point, 3); `cells`: numbers of the corners of each triangle, counter-clockwise
    seen from the tip of the normal.
    """

    points: Points
    cells: Int[np.ndarray, "cell 3"]

    @property
    def areas(self) -> Float[np.ndarray, " cell"]:
        """Areas of the triangles."""
        return np.asarray(np.linalg.norm(vector_areas(self.points, self.cells), axis=1))

    def of_cells(self, kept: Bool[np.ndarray, " cell"]) -> "Mesh":
        """Return some of the triangles, with the points that they use."""
        used, cells = np.unique(self.cells[kept], return_inverse=True)
        return Mesh(self.points[used], cells.reshape(-1, 3))

    @cached_property
    def edges(self) -> tuple[Sides, Int[np.ndarray, " edge"]]:
        """Sides of triangles, the lower number first, and to how many triangles each belongs."""
        return triangle_sides(len(self.points), self.cells)

    @cached_property
    def neighbours(self) -> csr_array:
        """Which points share a side, shape (point, point)."""
        a, b = self.edges[0].T
        both = np.concatenate([a, b]), np.concatenate([b, a])
        return coo_array((np.ones(2 * len(a)), both), shape=(len(self.points),) * 2).tocsr()

    @property
    def on_rim(self) -> Bool[np.ndarray, " point"]:
        """Which points lie where the surface ends."""
        edges, counts = self.edges
        out = np.zeros(len(self.points), bool)
        out[edges[counts == 1].ravel()] = True
        return out

    def averaged(self, values: PerPoint, weights: PerPoint, *, rounds: int) -> PerPoint:
        """Return values averaged over each point and its neighbours, several times."""
        total, weight = values * weights, weights
        for _ in range(rounds):
            total, weight = total + self.neighbours @ total, weight + self.neighbours @ weight
            scale = max(float(weight.max()), 1e-300)
            total, weight = total / scale, weight / scale
        return np.where(weight > 0, total / np.maximum(weight, 1e-300), values)


def cut(mesh: Mesh, axis: int, at: float) -> Float[np.ndarray, "segment 2 3"]:
    """Return the segments in which the plane at a coordinate of an axis (0, 1, 2) cuts the triangles."""
    corners = mesh.points[mesh.cells]
    height = corners[:, :, axis] - at
    above = height > 0
    crossed = above.any(axis=1) & ~above.all(axis=1)
    corners, height, above = corners[crossed], height[crossed], above[crossed]
    odd = np.argmax(above == (above.sum(axis=1) == 1)[:, None], axis=1)
    rows, ends = np.arange(len(odd)), []
    for turn in (1, 2):
        other = (odd + turn) % 3
        share = height[rows, odd] / (height[rows, odd] - height[rows, other])
        ends.append(corners[rows, odd] + share[:, None] * (corners[rows, other] - corners[rows, odd]))
    return np.stack(ends, axis=1)


def thinned(mesh: Mesh, target: int) -> Mesh:
    """Return the surface with at most `target` triangles, if so few can hold it."""
    random, tensors, vectors = np.random.default_rng(1), *_quadrics(mesh)
    share, stuck = _CHEAPEST, 0
    for _ in range(_ROUNDS):
        excess = len(mesh.cells) - target
        if excess <= 0 or stuck > _STUCK or len(mesh.points) <= _SIMPLEX:
            break
        edges, cost, places = _collapses(mesh, tensors, vectors)
        cheap = np.flatnonzero(cost <= np.quantile(cost, share)) if len(cost) else np.zeros(0, int)
        chosen = _apart(mesh, edges[cheap], random)
        edges, cost, places = (one[cheap][chosen] for one in (edges, cost, places))
        sound = _sound(mesh, edges, places)
        edges, cost, places = (one[sound] for one in (edges, cost, places))
        first = np.argsort(cost, kind="stable")[: max((excess + 1) // 2, 1)]
        edges, places = edges[first], places[first]
        stuck, share = (0, _CHEAPEST) if len(edges) else (stuck + 1, 1.0)
        tensors[edges[:, 0]] += tensors[edges[:, 1]]
        vectors[edges[:, 0]] += vectors[edges[:, 1]]
        mesh, used = _collapsed(mesh, edges, places)
        tensors, vectors = tensors[used], vectors[used]
    return mesh


def _quadrics(mesh: Mesh) -> tuple[Float[np.ndarray, "point 3 3"], Points]:
    """Return A and b of the sum of squared distances xᵀAx - 2bᵀx + c to the planes at each point, weighted by area."""
    areas = vector_areas(mesh.points, mesh.cells)
    size = np.maximum(np.linalg.norm(areas, axis=1), 1e-30)
    tensor = areas[:, :, None] * areas[:, None, :] / size[:, None, None]
    vector = np.einsum("cij,cj->ci", tensor, mesh.points[mesh.cells[:, 0]])
    both, sums = np.hstack([tensor.reshape(-1, 9), vector]), np.zeros((len(mesh.points), 12))
    for corner in range(3):
        for k in range(12):
            sums[:, k] += np.bincount(mesh.cells[:, corner], both[:, k], len(mesh.points))
    return sums[:, :9].reshape(-1, 3, 3), sums[:, 9:].copy()


def _collapses(
    mesh: Mesh, tensors: Float[np.ndarray, "point 3 3"], vectors: Points
) -> tuple[Sides, Float[np.ndarray, " edge"], Places]:
    """Return the sides that may collapse, what each costs, and the point that it becomes.

    The surface keeps its rim: a side collapses onto it or along it, but none that joins two parts of it does.
    """
    (edges, counts), rim = mesh.edges, mesh.on_rim
    ends = rim[edges]
    allowed = (counts <= 2) & ~(ends.all(axis=1) & (counts == 2))
    edges, ends = edges[allowed], ends[allowed]
    one, two = mesh.points[edges[:, 0]], mesh.points[edges[:, 1]]
    middle, length = 0.5 * (one + two), ((one - two) ** 2).sum(axis=1)
    tensor, vector = tensors[edges].sum(axis=1), vectors[edges].sum(axis=1)
    size = np.maximum(np.trace(tensor, axis1=1, axis2=2), 1e-12)
    slope = vector - np.einsum("eij,ej->ei", tensor, middle)
    move = np.linalg.solve(tensor + (_EVEN * size)[:, None, None] * np.eye(3), slope[..., None])[..., 0]
    far = np.sqrt((move**2).sum(axis=1) / np.maximum(length, 1e-30))
    place = middle + move / np.maximum(1.0, far)[:, None]
    place = np.where(ends[:, :1], np.where(ends[:, 1:], middle, one), np.where(ends[:, 1:], two, place))
    change = place - middle
    lost = np.einsum("ei,eij,ej->e", change, tensor, change) - 2 * (slope * change).sum(axis=1)
    base = np.einsum("ei,eij,ej->e", one - two, tensor, one - two) / 4
    return edges, np.maximum(lost + base, 0.0) + _EVEN * size * length, place


def _apart(mesh: Mesh, edges: Sides, random: np.random.Generator) -> Int[np.ndarray, " chosen"]:
    """Return sides of which no two have neighbouring ends, drawn at random."""
    keys, none = random.permutation(len(edges)), len(edges)
    least = np.full(len(mesh.points), none)
    for corner in range(2):
        np.minimum.at(least, edges[:, corner], keys)
    around = least.copy()
    both = mesh.edges[0]
    np.minimum.at(around, both[:, 0], least[both[:, 1]])
    np.minimum.at(around, both[:, 1], least[both[:, 0]])
    return np.flatnonzero((around[edges] == keys[:, None]).all(axis=1))


def _sound(mesh: Mesh, edges: Sides, places: Places) -> Bool[np.ndarray, " edge"]:
    """Return which collapses neither pinch nor fold the surface."""
    if not len(edges):
        return np.zeros(0, bool)
    links = mesh.neighbours
    common = np.asarray(links[edges[:, 0]].multiply(links[edges[:, 1]]).sum(axis=1)).ravel()
    number = np.full(len(mesh.points), -1)
    number[edges] = np.arange(len(edges))[:, None]
    of_corner = number[mesh.cells]
    touched = (of_corner >= 0).any(axis=1)
    cells, of_corner = mesh.cells[touched], of_corner[touched]
    edge, ends = of_corner.max(axis=1), (of_corner >= 0).sum(axis=1)
    vanishing = np.bincount(edge[ends == 2], minlength=len(edges))
    sound = np.asarray(common == vanishing)
    left = ends == 1
    before = mesh.points[cells]
    after = np.where((of_corner >= 0)[..., None], places[edge][:, None], before)[left]
    (old, thin), (new, thinner) = _shape(before), _shape(after)
    worst, left_worst = np.full(len(edges), _THIN), np.full(len(edges), np.inf)
    np.minimum.at(worst, edge, thin)
    np.minimum.at(left_worst, edge[left], thinner)
    sound &= left_worst >= worst
    sound[edge[left][(old[left] * new).sum(axis=1) < _TURNED]] = False
    return sound


def _shape(corners: Float[np.ndarray, "cell 3 3"]) -> tuple[Float[np.ndarray, "cell 3"], Float[np.ndarray, " cell"]]:
    """Return the unit normal of each triangle, and its area over the square of its longest side."""
    a, b, c = (corners[:, k] for k in range(3))
    area = 0.5 * np.cross(b - a, c - a)
    size = np.linalg.norm(area, axis=1)
    longest = np.max([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    return area / np.maximum(size, 1e-30)[:, None], size / np.maximum(longest, 1e-30)


def _collapsed(mesh: Mesh, edges: Sides, places: Places) -> tuple[Mesh, Int[np.ndarray, " left"]]:
    """Return the surface after the collapses, and the numbers that its points had before."""
    points, target = mesh.points.copy(), np.arange(len(mesh.points))
    points[edges[:, 0]], target[edges[:, 1]] = places, edges[:, 0]
    cells = target[mesh.cells]
    cells = cells[(cells != np.roll(cells, 1, axis=1)).all(axis=1)]
    used, cells = np.unique(cells, return_inverse=True)
    return Mesh(points[used], cells.reshape(-1, 3)), used


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
    stretch: Lengths
    sigma: float

    @property
    def extent(self) -> Lengths:
        """Place (x, y, z) of the last voxel; that of the first is 0."""
        return np.asarray((np.array(self.values.shape[::-1]) - 1) * self.stretch)

    @property
    def level(self) -> float:
        """Grey value half way between those of the dark and of the bright part."""
        return 0.5 * sum(two_levels(self.values))


def field_of(values: Float[np.ndarray, "z row column"], stretch: Lengths, *, smooth: float | None) -> Field:
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
    step = max(1, round((values.size / _EVERY) ** (1 / 3)))
    some = values[::step, ::step, ::step].ravel()
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


def _blurred(values: Voxels, sigma: float, stretch: Lengths) -> Voxels:
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
    bright = inner > level  # neighbours on different sides: points of the finest grid, with two triangles each
    found = 2 * sum(int(np.count_nonzero(np.diff(bright, axis=axis))) for axis in range(3))
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


def _merged(points: Float[np.ndarray, "point 3"], cells: Int[np.ndarray, "cell 3"]) -> Mesh:
    """Return the surface without triangles of which two corners coincide."""
    keys = np.rint(points * 2**12).astype(np.int64)
    _, first, number = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    merged = number.ravel()[cells]
    apart = (merged != np.roll(merged, 1, axis=1)).all(axis=1)
    return Mesh(points[first], merged).of_cells(apart)
