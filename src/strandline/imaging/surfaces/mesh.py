"""Triangles while they are worked on, without the checks of an interface, and how they become fewer.

Sides collapse where that moves the surface least. The error of a collapse is the sum of the squared distances to the
planes of the triangles that went into its two ends (Garland and Heckbert 1997). Many sides collapse at a time, so far
from each other that none sees another one, and only where the surface stays one without folds.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array, csr_array

from strandline.interface import vector_areas

Points = Float[np.ndarray, "point 3"]
PerPoint = Float[np.ndarray, " point"]
Sides = Int[np.ndarray, "edge 2"]
Places = Float[np.ndarray, "edge 3"]
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
        one, two = self.cells.ravel(), np.roll(self.cells, -1, axis=1).ravel()
        number = len(self.points)
        keys, counts = np.unique(np.minimum(one, two) * number + np.maximum(one, two), return_counts=True)
        return np.stack([keys // number, keys % number], axis=1), counts

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
    tensors, vectors = np.zeros((len(mesh.points), 9)), np.zeros((len(mesh.points), 3))
    for corner in range(3):
        at = mesh.cells[:, corner]
        for k in range(9):
            tensors[:, k] += np.bincount(at, tensor.reshape(-1, 9)[:, k], len(mesh.points))
        for k in range(3):
            vectors[:, k] += np.bincount(at, vector[:, k], len(mesh.points))
    return tensors.reshape(-1, 3, 3), vectors


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
