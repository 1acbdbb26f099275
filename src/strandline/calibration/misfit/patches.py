"""Patches of a surface: compact pieces of about the same size, the same each time."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

__all__ = ["PATCHES", "patches_of"]

PATCHES, FEWEST_POINTS = 8, 4
"""Patches of a surface, and the fewest points of a patch on average."""
ROUNDS = 20
"""Most rounds in which the middles of the patches move."""


def patches_of(points: Float[np.ndarray, "point 3"]) -> Int[np.ndarray, " point"]:
    """Return the number of the patch to which each point belongs.

    The middles begin with the point farthest from the centre and the points farthest from those before; then each moves
    to the mean of the points nearest to it (k-means).
    """
    count = max(min(PATCHES, len(points) // FEWEST_POINTS), 1)
    away = np.linalg.norm(points - points.mean(axis=0), axis=1)
    chosen = [int(np.argmax(away))]
    apart = np.full(len(points), np.inf)
    for _ in range(count - 1):
        apart = np.minimum(apart, np.linalg.norm(points - points[chosen[-1]], axis=1))
        chosen.append(int(np.argmax(apart)))
    middles = points[chosen]
    which = np.zeros(len(points), dtype=int)
    for _ in range(ROUNDS):
        which = np.asarray(cKDTree(middles).query(points)[1], dtype=int)
        kept = np.unique(which)
        moved = np.stack([points[which == k].mean(axis=0) for k in kept])
        if moved.shape == middles.shape and np.allclose(moved, middles, rtol=0, atol=1e-12 * float(np.ptp(points))):
            break
        middles = moved
    return np.unique(which, return_inverse=True)[1].astype(int)
