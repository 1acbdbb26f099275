"""Tempering steps for a log-likelihood of NumPy arrays; everything else is compiled around it, in pieces.

The pieces do not contain the function, so they can be kept from one process to the next, whatever the function is.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key, UInt32

from strandline.smc.moves import BatchedLogDensity, Moved, Positions, RandomKey, Scalar, accepted, proposed
from strandline.smc.steps import Begun, Info, Particles, begin, end

Keys = Key[Array, " case"] | UInt32[Array, "case 2"]
_begin: Callable[..., Begun] = jax.jit(begin)
_accept: Callable[..., Moved] = partial(jax.jit, static_argnames="steps")(accepted)
_begin_each: Callable[..., Begun] = jax.jit(jax.vmap(begin, in_axes=(0, 0, None, None)))


@dataclass(frozen=True)
class OnHost:
    """A log-likelihood of NumPy arrays for the sampler, which does not compile it."""

    function: Callable[[Float[np.ndarray, "point dim"]], Float[np.ndarray, " point"]]
    on_host = True

    def __call__(self, x: Any) -> Any:
        return self.function(x)


def is_on_host(log_likelihood: Any) -> bool:
    """Return whether a log-likelihood needs NumPy arrays: its attribute `on_host` is true."""
    return bool(getattr(log_likelihood, "on_host", False))


def advance_on_host(
    key: RandomKey,
    state: Particles,
    zeta: Scalar,
    resample_below: Scalar,
    *,
    target: tuple[Any, BatchedLogDensity],
    moves: int,
) -> tuple[Particles, Info]:
    """Advance as `strandline.smc.steps.advance` does, with the same proposals and tosses, but log L on the host."""
    log_likelihood, log_prior = target
    for_resampling, for_moves = jax.random.split(key)
    begun = _begin(for_resampling, state, zeta, resample_below)
    now = begun.start
    for step in range(moves):
        proposal, prior = _propose(for_moves, step, now.positions, begun.factor, log_prior=log_prior)
        likelihood = _inside(log_likelihood, ~np.isneginf(np.asarray(prior)), np.asarray(proposal))
        now = _accept(for_moves, step, now, proposal, likelihood, prior, begun.temperature, steps=moves)
    return end(begun, now, state.narrowest)


def advance_each_on_host(
    keys: Keys,
    states: Particles,
    given: Float[np.ndarray, "case given"],
    zeta: Scalar,
    resample_below: Scalar,
    *,
    target: tuple[Callable[..., Any], BatchedLogDensity],
    moves: int,
) -> tuple[Particles, Info]:
    """Advance every case that has not reached γ = 1; log L is evaluated for the particles of all cases at once.

    Cases are on the leading axis; log L in `target` is a function of points and as many rows of θ.
    """
    log_likelihood, log_prior = target
    active = np.asarray(states.temperature) < 1.0
    pairs = jax.vmap(jax.random.split)(keys)
    begun = _begin_each(pairs[:, 0], states, zeta, resample_below)
    now = begun.start
    for step in range(moves):
        proposal, prior = _propose_each(pairs[:, 1], step, now.positions, begun.factor, log_prior=log_prior)
        inside = ~np.isneginf(np.asarray(prior)) & active[:, None]
        theta = np.broadcast_to(given[:, None], (*inside.shape, given.shape[1]))
        likelihood = _inside(log_likelihood, inside, np.asarray(proposal), theta)
        now = _accept_each(pairs[:, 1], step, now, proposal, likelihood, prior, begun.temperature, steps=moves)
    after, info = jax.vmap(end)(begun, now, states.narrowest)
    kept: Particles = jax.tree.map(partial(jax.vmap(jnp.where), active), after, states)
    return kept, info


def _inside(function: Callable[..., Any], inside: Bool[np.ndarray, "*case"], *arguments: Any) -> Any:
    """Return the function's values where `inside` is true, and -inf elsewhere; arguments have these axes first."""
    out = np.full(inside.shape, -np.inf)
    if inside.any():
        out[inside] = function(*(one[inside] for one in arguments))
    return out


def _proposal(
    key: RandomKey,
    step: Int[Array, ""],
    positions: Positions,
    factor: Float[Array, "dim dim"],
    *,
    log_prior: BatchedLogDensity,
) -> tuple[Positions, Float[Array, " particle"]]:
    proposal = proposed(key, step, positions, factor)
    return proposal, log_prior(proposal)


_propose: Callable[..., Any] = partial(jax.jit, static_argnames="log_prior")(_proposal)


@partial(jax.jit, static_argnames="log_prior")
def _propose_each(keys: Any, step: Any, positions: Any, factor: Any, *, log_prior: BatchedLogDensity) -> Any:
    each = jax.vmap(partial(_proposal, log_prior=log_prior), in_axes=(0, None, 0, 0))
    return each(keys, step, positions, factor)


@partial(jax.jit, static_argnames="steps")
def _accept_each(
    keys: Any, step: Any, now: Moved, proposal: Any, likelihood: Any, prior: Any, temperature: Any, *, steps: int
) -> Any:
    each = jax.vmap(partial(accepted, steps=steps), in_axes=(0, None, 0, 0, 0, 0, 0))
    return each(keys, step, now, proposal, likelihood, prior, temperature)
