"""The next temperature of π_γ ∝ L^γ p from the loss of effective sample size."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

_HALVINGS = 64
_LEAST = 1e-100
"""Least increment of the temperature: noise of 1e-50 of the range still leaves one."""

Scalar = Float[Array, ""]
PerParticle = Float[Array, " particle"]


def effective_sample_size(log_weights: PerParticle) -> Scalar:
    """Return (Σ w)² / Σ w²; log weights of any normalisation, -inf allowed."""
    return jnp.exp(2 * jax.nn.logsumexp(log_weights) - jax.nn.logsumexp(2 * log_weights))


def reweighted(log_weights: PerParticle, log_likelihood: PerParticle, increment: Scalar) -> PerParticle:
    """Return log(w L^increment); a particle of zero likelihood has zero weight at any increment, including 0."""
    dead = jnp.isneginf(log_likelihood)
    return jnp.where(dead, -jnp.inf, log_weights + increment * jnp.where(dead, 0.0, log_likelihood))


def next_temperature(
    log_weights: PerParticle, log_likelihood: PerParticle, temperature: Scalar, zeta: Scalar | float
) -> Scalar:
    """Return γ' with ESS(γ') = ζ·ESS(γ) by bisection of log(γ' - γ), or 1 if ESS(1) is at least that.

    Particles of zero likelihood die at the first positive increment, whatever its size, so ESS(γ) counts only the
    others. Log weights have any normalisation; ζ, in (0, 1), is the share of the effective sample size to keep.
    """

    def size(increment: Scalar) -> Scalar:
        return effective_sample_size(reweighted(log_weights, log_likelihood, increment))

    full = 1.0 - temperature
    wanted = zeta * size(jnp.zeros_like(full))

    def halve(_: Int[Array, ""], bracket: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
        low, high = bracket
        middle = jnp.sqrt(low) * jnp.sqrt(high)
        enough = size(middle) >= wanted
        return jnp.where(enough, middle, low), jnp.where(enough, high, middle)

    low, _ = jax.lax.fori_loop(0, _HALVINGS, halve, (jnp.full_like(full, _LEAST), full))
    return jnp.where(size(full) >= wanted, 1.0, temperature + low)
