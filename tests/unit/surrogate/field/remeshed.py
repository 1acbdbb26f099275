"""Surfaces of a closed form, triangulated anew at every call."""

from collections.abc import Callable

import numpy as np
from scipy.spatial import ConvexHull, Delaunay

from strandline.interface import Interface

Height = Callable[[np.ndarray, np.ndarray], np.ndarray]


def disc(rings: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return points of the unit disc (point, 2) and triangles: rings of them, each turned and its points moved."""
    rng = np.random.default_rng(seed)
    points = [np.zeros((1, 2))]
    for k in range(1, rings + 1):
        number = 6 * k
        angle = 2 * np.pi * (np.arange(number) + rng.uniform() + rng.uniform(-0.15, 0.15, number)) / number
        radius = 1.0 if k == rings else (k + rng.uniform(-0.15, 0.15, number)) / rings
        points.append(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1))
    flat = np.concatenate(points)
    cells = Delaunay(flat).simplices
    a, b, c = (flat[cells[:, k]] for k in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    cells[area < 0] = cells[area < 0, ::-1]
    return flat, cells.astype(int)


def cap(height: Height, rings: int, seed: int, *, radius: float = 1.0) -> Interface:
    """Return the graph of a height over a disc, facing up."""
    flat, cells = disc(rings, seed)
    x, y = radius * flat.T
    return Interface(np.stack([x, y, height(x, y)], axis=1), cells)


def ellipsoid(axes: tuple[float, float, float], number: int, seed: int) -> Interface:
    """Return an ellipsoid through the images of points spread evenly over a turned sphere; it faces outwards."""
    rng = np.random.default_rng(seed)
    k = np.arange(number) + 0.5
    z, angle = 1 - 2 * k / number, np.pi * (1 + np.sqrt(5)) * k
    r = np.sqrt(1 - z**2)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    ball = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1) @ rotation.T
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    cells = ConvexHull(ball).simplices.astype(int)
    inward = np.linalg.det(ball[cells]) < 0
    cells[inward] = cells[inward, ::-1]
    return Interface(ball * np.array(axes), cells)
