"""Triangles while they are worked on, without the checks of an interface."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array, csr_array

__all__ = ["Mesh", "cut", "vector_areas"]


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles in space.

    Args:
        points: Corners (x, y, z), shape (point, 3).
        cells: Numbers of the corners of each triangle, counter-clockwise seen from the tip of the normal.
    """

    points: Float[np.ndarray, "point 3"]
    cells: Int[np.ndarray, "cell 3"]

    def of_cells(self, kept: Bool[np.ndarray, " cell"]) -> "Mesh":
        """Return some of the triangles, with the points that they use."""
        used, cells = np.unique(self.cells[kept], return_inverse=True)
        return Mesh(self.points[used], cells.reshape(-1, 3))

    @cached_property
    def edges(self) -> tuple[Int[np.ndarray, "edge 2"], Int[np.ndarray, " edge"]]:
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

    def averaged(
        self, values: Float[np.ndarray, " point"], weights: Float[np.ndarray, " point"], *, rounds: int
    ) -> Float[np.ndarray, " point"]:
        """Return values averaged over each point and its neighbours, several times."""
        total, weight = values * weights, weights
        for _ in range(rounds):
            total, weight = total + self.neighbours @ total, weight + self.neighbours @ weight
            scale = max(float(weight.max()), 1e-300)
            total, weight = total / scale, weight / scale
        return np.where(weight > 0, total / np.maximum(weight, 1e-300), values)


def cut(mesh: Mesh, axis: int, at: float) -> Float[np.ndarray, "segment 2 3"]:
    """Return the segments in which a plane at right angles to an axis cuts the triangles.

    Args:
        mesh: The triangles.
        axis: The axis, 0, 1 or 2.
        at: Coordinate of the plane on it.
    """
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


def vector_areas(points: Float[np.ndarray, "point 3"], cells: Int[np.ndarray, "cell 3"]) -> Float[np.ndarray, "cell 3"]:
    """Return the normal of each triangle times its area."""
    a, b, c = (points[cells[:, k]] for k in range(3))
    return np.asarray(0.5 * np.cross(b - a, c - a))
