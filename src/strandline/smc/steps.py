"""One tempering step of Algorithm 1 (Willmann et al. 2022) as pure functions of states."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key, UInt32

from strandline.smc.moves import (
    BatchedLogDensity,
    Moved,
    RandomKey,
    Scalar,
    metropolis,
    proposal_factor,
    proposal_scale,
    unmoved,
)
from strandline.smc.tempering import effective_sample_size, next_temperature, reweighted

_SLACK = 1e-3
"""Relative tolerance: the effective sample size approaches its target from above and, within this, counts as met."""


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


class Particles(NamedTuple):
    """State between two tempering steps; `log_weights` are normalised."""

    positions: Float[Array, "particle dim"]
    log_weights: Float[Array, " particle"]
    log_likelihood: Float[Array, " particle"]
    log_prior: Float[Array, " particle"]
    temperature: Float[Array, ""]
    acceptance: Float[Array, ""]
    narrowest: Float[Array, " dim"]


class Info(NamedTuple):
    """What one tempering step did, on the device."""

    ess: Float[Array, ""]
    resampled: Array
    log_evidence_increment: Float[Array, ""]
    covariance_scale: Float[Array, ""]
    undefined: Array


class Begun(NamedTuple):
    """A tempering step before its moves."""

    start: Moved
    log_weights: Float[Array, " particle"]
    temperature: Float[Array, ""]
    factor: Float[Array, "dim dim"]
    info: Info


def advance(
    key: RandomKey,
    state: Particles,
    zeta: Scalar,
    resample_below: Scalar,
    *,
    target: tuple[BatchedLogDensity, BatchedLogDensity],
    moves: int,
) -> tuple[Particles, Info]:
    """Temper, reweight, resample if needed, rejuvenate: one iteration of Algorithm 1."""
    for_resampling, for_moves = jax.random.split(key)
    begun = begin(for_resampling, state, zeta, resample_below)
    moved = metropolis(
        for_moves, *begun.start[:3], target=target, temperature=begun.temperature, factor=begun.factor, steps=moves
    )
    return end(begun, moved, state.narrowest)


def begin(key: RandomKey, state: Particles, zeta: Scalar, resample_below: Scalar) -> Begun:
    """Temper, reweight, resample if needed."""
    number = len(state.log_weights)
    temperature = next_temperature(state.log_weights, state.log_likelihood, state.temperature, zeta)
    log_weights = reweighted(state.log_weights, state.log_likelihood, temperature - state.temperature)
    increment = jax.nn.logsumexp(log_weights)
    log_weights = log_weights - increment
    ess = effective_sample_size(log_weights)
    resample = ess <= resample_below * number * (1 + _SLACK)
    chosen = jnp.where(resample, systematic(key, log_weights), jnp.arange(number))
    log_weights = jnp.where(resample, -jnp.log(number), log_weights)
    positions = state.positions[chosen]
    scale = proposal_scale(state.acceptance)
    start = unmoved(positions, state.log_likelihood[chosen], state.log_prior[chosen])
    factor = jnp.sqrt(scale) * proposal_factor(positions, jnp.exp(log_weights), state.narrowest)
    return Begun(start, log_weights, temperature, factor, Info(ess, resample, increment, scale, start.undefined))


def end(begun: Begun, moved: Moved, narrowest: Float[Array, " dim"]) -> tuple[Particles, Info]:
    """Return the state after the moves, and what the step did."""
    after = Particles(
        moved.positions,
        begun.log_weights,
        moved.log_likelihood,
        moved.log_prior,
        begun.temperature,
        moved.acceptance,
        narrowest,
    )
    return after, begun.info._replace(undefined=moved.undefined)
