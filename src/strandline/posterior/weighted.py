"""Weighted draws: their moments, and draws of equal weight from them."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

PerParticle = Float[np.ndarray, " particle"]


@dataclass(frozen=True, eq=False)
class Weighted:
    """Draws with their weights, which sum to one."""

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
    def ess(self) -> float:
        """Effective sample size of the weights, 1 / Σ w²."""
        return float(1.0 / np.sum(self.weights**2))

    @property
    def covariance(self) -> Float[np.ndarray, "dim dim"]:
        """Second central moment, shape (dim, dim)."""
        centred = self.draws - self.mean
        return np.asarray((self.weights[:, None] * centred).T @ centred)


def systematic_indices(weights: PerParticle, number: int, rng: np.random.Generator) -> Int[np.ndarray, " draw"]:
    """Return `number` particle indices, ascending, by systematic resampling: one uniform number, equal strides."""
    positions = (rng.random() + np.arange(number)) / number
    cumulative = np.cumsum(weights)
    found = np.searchsorted(cumulative, positions * cumulative[-1], side="right")
    return np.asarray(np.minimum(found, np.flatnonzero(weights)[-1]))


def generator(seed: Any) -> np.random.Generator:
    """Return a NumPy generator from an integer, a generator or a JAX key."""
    if isinstance(seed, jax.Array):
        is_typed = jnp.issubdtype(seed.dtype, jax.dtypes.prng_key)
        words = jax.random.key_data(seed) if is_typed else seed
        return np.random.default_rng(np.asarray(words).ravel())
    return np.random.default_rng(seed)
