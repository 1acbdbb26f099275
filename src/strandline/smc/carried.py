"""Particles of one likelihood carried over to another one close by: reweighted, then resampled and moved if needed."""

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

__all__ = ["carried_over"]

KEPT = 0.3
"""Least effective share of the particles from which sampling goes on."""
ENOUGH = 0.9
"""Effective share from which the weights alone are good enough."""
ROUNDS = 2
"""Rounds of moves that follow otherwise."""
SCOUTS = 1000
"""Draws of the prior that are tried."""
OUTSIDE = 5.0
"""Distance from the mean, in standard deviations of the particles, from which a draw is outside."""
ELSEWHERE = 0.01
"""Largest share of the evidence that draws of the prior may find outside the particles."""
FIRST_ACCEPTANCE = 0.3
"""Share of accepted moves that the size of the first proposals assumes."""


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

    Args:
        key: Random key; do not use it again.
        found: Particles of a likelihood close by.
        log_likelihood: log L, a function of NumPy arrays.
        log_prior: log p.
        scouts: Draws of the prior.
        extents: Extents of the prior, which keep proposals from collapsing.
        settings: The sampler's settings.
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
    """Return the scouts that are far from all particles."""
    mean = weights @ x
    sd = np.sqrt(weights @ (x - mean) ** 2)
    far = (np.abs(scouts - mean) > OUTSIDE * np.maximum(sd, np.finfo(float).tiny)).any(axis=1)
    return np.asarray(scouts[far])
