"""Random-walk Metropolis-Hastings moves of all particles at once."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key, UInt32

BatchedLogDensity = Callable[[Float[Array, "particle dim"]], Float[Array, " particle"]]
RandomKey = Key[Array, ""] | UInt32[Array, "2"]
Scalar = Float[Array, ""]
PerParticle = Float[Array, " particle"]
Positions = Float[Array, "particle dim"]

OFFSET, SLOPE = 1 / 9, 8 / 9  # a and b of the scale a + b·(mean acceptance)
_JITTER = 1e-10  # added to the correlation matrix
NARROWEST = 1e-8  # smallest standard deviation of a proposal, relative to that of the initial particles


class Moved(NamedTuple):
    """Particles after some moves: physical positions, with log L and log p there.

    `acceptance` is the share of accepted proposals, over all particles and moves; `undefined` counts those inside the
    support whose log-likelihood was NaN or +inf, which were rejected.
    """

    positions: Positions
    log_likelihood: PerParticle
    log_prior: PerParticle
    acceptance: Scalar
    undefined: Int[Array, ""]


def proposal_scale(acceptance: Scalar) -> Scalar:
    """Return (a + b·mean acceptance)², the factor of the proposal covariance (Algorithm 1; a = 1/9, b = 8/9)."""
    return (OFFSET + SLOPE * acceptance) ** 2


def proposal_factor(positions: Positions, weights: PerParticle, floor: Float[Array, " dim"]) -> Float[Array, "dim dim"]:
    """Return a lower triangular factor F of the weighted covariance, F Fᵀ = Σ w (x - m)(x - m)ᵀ; weights are
    normalised.

    `floor` is the smallest standard deviation by input; it keeps a collapsed population moving.
    """
    centred = positions - weights @ positions
    covariance = (weights[:, None] * centred).T @ centred
    sd = jnp.maximum(jnp.sqrt(jnp.diagonal(covariance)), floor)
    safe = jnp.where(sd > 0, sd, 1.0)
    correlation = covariance / jnp.outer(safe, safe)
    correlation = jnp.where(jnp.eye(len(sd), dtype=bool), 1.0 + _JITTER, correlation)
    factor: Array = sd[:, None] * jnp.linalg.cholesky(correlation)
    return factor


def metropolis(
    key: RandomKey,
    positions: Positions,
    log_likelihood: PerParticle,
    log_prior: PerParticle,
    *,
    target: tuple[BatchedLogDensity, BatchedLogDensity],
    temperature: Scalar,
    factor: Float[Array, "dim dim"],
    steps: int,
) -> Moved:
    """Move every particle so many steps, one proposal each, with a kernel that leaves π_γ ∝ L^γ p invariant.

    log L and log p are those at the physical positions, the target is both as batched, jittable functions; where log p
    is -inf, a proposal is rejected. The temperature is γ, and proposals have the covariance F Fᵀ with the factor F. Do
    not use the random key again.
    """

    def move(step: Int[Array, ""], now: Moved) -> Moved:
        proposal = proposed(key, step, now.positions, factor)
        prior, likelihood = target[1](proposal), target[0](proposal)
        return accepted(key, step, now, proposal, likelihood, prior, temperature, steps=steps)

    moved: Moved = jax.lax.fori_loop(0, steps, move, unmoved(positions, log_likelihood, log_prior))
    return moved


def unmoved(positions: Positions, log_likelihood: PerParticle, log_prior: PerParticle) -> Moved:
    """Return particles before the first move."""
    return Moved(positions, log_likelihood, log_prior, jnp.zeros((), log_prior.dtype), jnp.zeros((), int))


def proposed(key: RandomKey, step: Int[Array, ""], positions: Positions, factor: Float[Array, "dim dim"]) -> Positions:
    """Return the proposals of move `step`."""
    walk, _ = jax.random.split(jax.random.fold_in(key, step))
    return positions + jax.random.normal(walk, positions.shape, positions.dtype) @ factor.T


def accepted(
    key: RandomKey,
    step: Int[Array, ""],
    now: Moved,
    proposal: Positions,
    likelihood: PerParticle,
    prior: PerParticle,
    temperature: Scalar,
    *,
    steps: int,
) -> Moved:
    """Return the particles after move `step` of `steps`, given log L and log p at the proposals."""
    _, toss = jax.random.split(jax.random.fold_in(key, step))
    undefined = jnp.isfinite(prior) & (jnp.isnan(likelihood) | jnp.isposinf(likelihood))
    likelihood = jnp.where(jnp.isneginf(prior) | undefined, -jnp.inf, likelihood)
    gain = _tempered(likelihood, prior, temperature) - _tempered(now.log_likelihood, now.log_prior, temperature)
    accept = jnp.log(jax.random.uniform(toss, gain.shape, gain.dtype)) < gain  # NaN (-inf - -inf) is rejected
    return Moved(
        jnp.where(accept[:, None], proposal, now.positions),
        jnp.where(accept, likelihood, now.log_likelihood),
        jnp.where(accept, prior, now.log_prior),
        now.acceptance + jnp.mean(accept.astype(gain.dtype)) / steps,
        now.undefined + jnp.sum(undefined),
    )


def _tempered(log_likelihood: PerParticle, log_prior: PerParticle, temperature: Scalar) -> PerParticle:
    """Return log(L^γ p); zero likelihood stays zero."""
    dead = jnp.isneginf(log_likelihood)
    return jnp.where(dead, -jnp.inf, log_prior + temperature * jnp.where(dead, 0.0, log_likelihood))
