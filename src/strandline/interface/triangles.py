"""Geometry of triangulated surfaces in space: functions of points (point, 3), mm, and corners (cell, 3)."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

Points = Float[np.ndarray, "point 3"]
Others = Float[np.ndarray, "other 3"]
Triangles = Int[np.ndarray, "cell 3"]


def vector_areas(points: Points, cells: Triangles) -> Float[np.ndarray, "cell 3"]:
    """Return the normal of each triangle times its area, mm²: the corners run counter-clockwise seen from its tip."""
    a, b, c = (points[cells[:, k]] for k in range(3))
    return np.asarray(0.5 * np.cross(b - a, c - a))


def shortest_altitudes(points: Points, cells: Triangles) -> Float[np.ndarray, " cell"]:
    """Return twice the area of each triangle over its longest side, mm; 0 if a corner is repeated."""
    corners = points[cells]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    twice = 2 * np.linalg.norm(vector_areas(points, cells), axis=1)
    return np.asarray(np.divide(twice, longest, out=np.zeros_like(twice), where=longest > 0))


def triangle_sides(points: int, cells: Triangles) -> tuple[Int[np.ndarray, "side 2"], Int[np.ndarray, " side"]]:
    """Return the sides between so many points, each once, the lower number first; how many triangles share each."""
    both = np.sort(np.stack([cells.ravel(), np.roll(cells, -1, axis=1).ravel()], axis=1), axis=1)
    found, counts = np.unique(both[:, 0] * points + both[:, 1], return_counts=True)
    return np.stack(np.divmod(found, points), axis=1), counts


def encloses(points: Points, cells: Triangles) -> bool:
    """Return whether the surface is closed: each side of a triangle belongs to one other, in the opposite direction."""
    one, two = cells.ravel(), np.roll(cells, -1, axis=1).ravel()
    there, back = np.sort(one * len(points) + two), np.sort(two * len(points) + one)
    return bool(np.array_equal(there, back) and (np.diff(there) > 0).all())


def signed_volume(points: Points, cells: Triangles) -> float:
    """Return the volume that a closed surface encloses, mm³; above 0 if the normals point outwards."""
    a, b, c = (points[cells[:, k]] - points.mean(axis=0) for k in range(3))
    return float(np.sum(a * np.cross(b, c))) / 6


def agreement(centres: Points, normals: Points, other_centres: Others, other_normals: Others) -> float:
    """Return the mean cosine between normals of each triangle and the nearest one of the other surface.

    The sum of the means over the areas of both surfaces: -2 … 2, below 0 if they face opposite sides.
    """
    there = cKDTree(other_centres).query(centres)[1]
    back = cKDTree(centres).query(other_centres)[1]
    return _mean_cosine(normals, other_normals[there]) + _mean_cosine(other_normals, normals[back])


def _mean_cosine(normals: Float[np.ndarray, "cell 3"], neighbours: Float[np.ndarray, "cell 3"]) -> float:
    areas = np.linalg.norm(normals, axis=1)
    return float(np.sum(normals * neighbours / np.linalg.norm(neighbours, axis=1, keepdims=True)) / areas.sum())
