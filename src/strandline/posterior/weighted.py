"""Moments of weighted draws."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

__all__ = ["Weighted"]


@dataclass(frozen=True, eq=False)
class Weighted:
    """Draws with their weights.

    Args:
        draws: Physical values, shape (draw, dim).
        weights: Weights that sum to one, shape (draw,).
    """

    draws: Float[np.ndarray, "draw dim"]
    weights: Float[np.ndarray, " draw"]

    @property
    def mean(self) -> Float[np.ndarray, " dim"]:
        """Mean, shape (dim,)."""
        return np.asarray(self.weights @ self.draws)

    @property
    def sd(self) -> Float[np.ndarray, " dim"]:
        """Standard deviations, shape (dim,)."""
        return np.asarray(np.sqrt(self.weights @ (self.draws - self.mean) ** 2))

    @property
    def covariance(self) -> Float[np.ndarray, "dim dim"]:
        """Second central moment, shape (dim, dim)."""
        centred = self.draws - self.mean
        return np.asarray((self.weights[:, None] * centred).T @ centred)
