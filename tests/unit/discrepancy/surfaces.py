"""Triangulated surfaces that tests share."""

import numpy as np

from strandline.interface import Interface


def sheet(
    nodes: int, *, size: float = 1.0, height: float = 0.0, bend: float = 0.0, seed: int | None = None
) -> Interface:
    """Return a square of nodes² points facing up at a height, in waves; its inner nodes moved at random by a seed."""
    u, v = np.meshgrid(*2 * [np.linspace(0.0, 1.0, nodes)], indexing="ij")
    if seed is not None:
        inner = (slice(1, -1),) * 2
        for one, moved in zip((u, v), np.random.default_rng(seed).uniform(-0.3, 0.3, (2, nodes, nodes)), strict=True):
            one[inner] += moved[inner] / (nodes - 1)
    points = np.stack([size * u, size * v, height + bend * np.sin(5 * u) * np.cos(4 * v)], axis=-1).reshape(-1, 3)
    first = (np.arange(nodes - 1)[:, None] * nodes + np.arange(nodes - 1)).ravel()
    one = np.stack([first, first + nodes, first + nodes + 1], axis=1)
    two = np.stack([first, first + nodes + 1, first + 1], axis=1)
    return Interface(points, np.concatenate([one, two]))


def sphere(radius: float, divisions: int) -> Interface:
    """Return an octahedron whose sides are halved some times, pushed out to a sphere; it faces outwards."""
    points = np.concatenate([np.eye(3), -np.eye(3)])
    cells = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])
    for _ in range(divisions):
        points, cells = _halved(points, cells)
        points /= np.linalg.norm(points, axis=1, keepdims=True)
    return Interface(radius * points, cells)


def divided(surface: Interface) -> Interface:
    """Return the same surface with every triangle cut in four."""
    return Interface(*_halved(surface.points, surface.cells))


def turned(surface: Interface, seed: int, shift: float = 3.0) -> Interface:
    """Return the surface after a rigid motion."""
    rng = np.random.default_rng(seed)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    rotation[:, 0] *= np.linalg.det(rotation)
    return Interface(surface.points @ rotation.T + shift * rng.normal(size=3), surface.cells)


def _halved(points: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    sides = np.concatenate([cells[:, [0, 1]], cells[:, [1, 2]], cells[:, [2, 0]]])
    pairs, number = np.unique(np.sort(sides, axis=1), axis=0, return_inverse=True)
    (a, b, c), (ab, bc, ca) = cells.T, len(points) + number.reshape(3, -1)
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    middles = points[pairs].mean(axis=1)
    return np.concatenate([points, middles]), np.concatenate([np.stack(part, axis=1) for part in parts])
