"""Two independent runs of the sampler joined into one, and particles carried over to another likelihood close by."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp

from strandline.smc.moves import NARROWEST, BatchedLogDensity, RandomKey
from strandline.smc.on_host import rejuvenate
from strandline.smc.records import SMCResult, SMCSettings
from strandline.smc.steps import Particles

FEWEST = 4  # number of particles from which there are two halves that the sampler accepts
FIRST = 2  # keeps the keys of the halves apart from those derived from the same key elsewhere
KEPT = 0.3  # least effective share of the particles from which sampling goes on
ENOUGH = 0.9
"""Effective share from which the weights alone are good enough."""
ROUNDS = 2  # rounds of moves that follow otherwise
SCOUTS = 1000  # draws of the prior that are tried
OUTSIDE = 5.0
"""Distance from the mean, in standard deviations of the particles, from which a draw is outside."""
ELSEWHERE = 0.01
"""Largest share of the evidence that draws of the prior may find outside the particles."""
FIRST_ACCEPTANCE = 0.3  # share of accepted moves that the size of the first proposals assumes


def in_halves(
    run: Callable[[RandomKey, Float[np.ndarray, "half dim"]], SMCResult],
    key: RandomKey,
    initial: Float[np.ndarray, "particle dim"],
) -> SMCResult:
    """Return the union of two runs with half the initial particles each; a single run if there are too few particles.

    `run` is the sampler as a function of a key and of initial particles, which are draws from the prior; do not use the
    key again: each half gets its own.
    """
    if len(initial) < FEWEST:
        return run(key, initial)
    halves = np.array_split(initial, 2)
    return joined(*(run(jax.random.fold_in(key, FIRST + i), half) for i, half in enumerate(halves)))


def joined(one: SMCResult, other: SMCResult) -> SMCResult:
    """Return the particles of two independent runs, weighted by evidence.

    Each run estimates the integral of any function times L p without bias, so the mean of the two does as well, and
    with it the evidence. A half that misses most of the mass has a small evidence, and so little weight. The steps are
    those of the first run.
    """
    halves, number = (one, other), len(one.positions) + len(other.positions)
    shares = [half.log_evidence + np.log(len(half.positions) / number) for half in halves]
    log_evidence = float(np.logaddexp(*shares))
    weights = [half.log_weights + share - log_evidence for half, share in zip(halves, shares, strict=True)]
    log_weights = np.concatenate(weights)
    return SMCResult(
        positions=np.concatenate([half.positions for half in halves]),
        log_weights=log_weights,
        log_likelihood=np.concatenate([half.log_likelihood for half in halves]),
        log_prior=np.concatenate([half.log_prior for half in halves]),
        log_evidence=log_evidence,
        ess=float(1.0 / np.sum(np.exp(2 * log_weights))),
        steps=one.steps,
        likelihood_evaluations=one.likelihood_evaluations + other.likelihood_evaluations,
        halves=halves,
    )


def carried_over(
    key: RandomKey,
    found: SMCResult,
    log_likelihood: Any,
    log_prior: BatchedLogDensity,
    *,
    scouts: Float[np.ndarray, "scout dim"],
    extents: Float[np.ndarray, " dim"],
    settings: SMCSettings,
) -> SMCResult | None:
    """Return particles of another likelihood; None if the two are not near, or if draws of the prior fit elsewhere.

    The extents of the prior keep proposals from collapsing, `scouts` are draws of it, and log L takes NumPy arrays; do
    not use the random key again.
    """
    x, values = found.positions, log_likelihood(found.positions)
    weights = found.log_weights + values - found.log_likelihood
    increment, moves = float(logsumexp(weights)), settings.rejuvenation_steps // ROUNDS
    if not np.isfinite(found.log_evidence + increment):
        return None
    weights = weights - increment
    effective = float(np.exp(-logsumexp(2 * weights))) / len(x)
    if effective < KEPT:
        return None
    state = Particles(
        jnp.asarray(x),
        jnp.asarray(weights),
        jnp.asarray(values),
        jax.jit(log_prior)(jnp.asarray(x)),
        jnp.ones(()),
        jnp.asarray(FIRST_ACCEPTANCE),
        NARROWEST * jnp.asarray(extents),
    )
    rounds = jax.random.split(key, ROUNDS) if effective < ENOUGH else ()
    for one in rounds:
        state = rejuvenate(one, state, log_likelihood, log_prior, moves=moves)
    positions, log_weights = np.asarray(state.positions), np.asarray(state.log_weights)
    outside = _outside(positions, np.exp(log_weights), scouts[:SCOUTS])
    if len(outside):
        elsewhere = logsumexp(log_likelihood(outside)) - np.log(len(scouts[:SCOUTS])) - found.log_evidence - increment
        if elsewhere > np.log(ELSEWHERE):
            return None
    return SMCResult(
        positions=positions,
        log_weights=log_weights,
        log_likelihood=np.asarray(state.log_likelihood),
        log_prior=np.asarray(state.log_prior),
        log_evidence=found.log_evidence + increment,
        ess=float(np.exp(-logsumexp(2 * log_weights))),
        steps=found.steps,
        likelihood_evaluations=found.likelihood_evaluations + len(x) * (1 + moves * len(rounds)),
    )


def _outside(
    x: Float[np.ndarray, "particle dim"], weights: Float[np.ndarray, " particle"], scouts: Float[np.ndarray, "some dim"]
) -> Float[np.ndarray, "few dim"]:
    mean = weights @ x
    sd = np.sqrt(weights @ (x - mean) ** 2)
    far = (np.abs(scouts - mean) > OUTSIDE * np.maximum(sd, np.finfo(float).tiny)).any(axis=1)
    return np.asarray(scouts[far])
