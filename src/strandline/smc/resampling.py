"""Systematic resampling."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key, UInt32

__all__ = ["systematic"]


def systematic(
    key: Key[Array, ""] | UInt32[Array, "2"], log_weights: Float[Array, " particle"]
) -> Int[Array, " particle"]:
    """Return the ancestors of as many particles as there are log weights, drawn with one uniform number.

    Particle i has ⌊N w_i⌋ or ⌈N w_i⌉ offspring, N w_i in expectation; a particle of zero weight has none.
    """
    number = log_weights.shape[0]
    cumulative = jnp.cumsum(jnp.exp(log_weights - jax.nn.logsumexp(log_weights)))
    offset = jax.random.uniform(key, dtype=cumulative.dtype)
    positions = (jnp.arange(number) + offset) / number * cumulative[-1]
    last = jnp.max(jnp.where(jnp.isneginf(log_weights), 0, jnp.arange(number)))
    return jnp.minimum(jnp.searchsorted(cumulative, positions, side="right"), last)
