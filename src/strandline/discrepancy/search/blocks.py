"""A batch of interfaces with the same cells in blocks of similar ones, and how far nodes move within a block."""

import numpy as np
from jaxtyping import Float, Int

__all__ = ["motion", "similar"]

_LOOKED_AT = 16
"""Nodes compared to find out which runs are alike."""


def similar(points: Float[np.ndarray, "run point xyz"], size: int) -> list[Int[np.ndarray, " some"]]:
    """Return the indices of the runs in blocks of at most `size`, similar runs together.

    They are ordered along the direction in which they differ most.
    """
    some = points[:, :: max(1, points.shape[1] // _LOOKED_AT)].reshape(len(points), -1)
    apart = some - some.mean(axis=0)
    _, vectors = np.linalg.eigh(apart.T @ apart)
    order = np.argsort(apart @ vectors[:, -1], kind="stable")
    return np.array_split(order, max(1, -(-len(points) // size)))


def motion(
    points: Float[np.ndarray, "run point xyz"],
) -> tuple[Float[np.ndarray, "point xyz"], Float[np.ndarray, " point"]]:
    """Return the middle of the box that holds each node in all runs, and half its diagonal: no run is farther away."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = 0.5 * (high - low)
    return low + half, np.sqrt(np.einsum("pk,pk->p", half, half))
