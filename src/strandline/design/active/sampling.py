"""The posterior that follows from what is known, as particles: sampled from the prior, or from the posterior before.

From one batch to the next the posterior moves little, so its particles are reweighted, resampled and moved: a tenth of
the evaluations of sampling from the prior. Particles that start from the last posterior cannot see a mode that has
appeared elsewhere. So draws of the prior are tried as well, and whatever is checked on the true model is sampled from
the prior. From the prior, a rough likelihood leads near the posterior if there is one; its particles go on to the exact
one in the same way.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.special import log_softmax, logsumexp

from strandline.design.active.state import Knowledge, State
from strandline.likelihood import OnHost
from strandline.numerics.one_thread import one_thread
from strandline.parameters import ParameterSpace
from strandline.smc import Particles, SMCSettings, StepInfo, rejuvenate, sample

__all__ = ["MANY_INPUTS_PARTICLES", "PARTICLES", "ROUGHLY", "SAMPLING", "posterior_state"]

SAMPLING = SMCSettings(rejuvenation_steps=10, zeta=0.5)
"""Settings of the sampler after each batch."""
ROUGHLY = SMCSettings(rejuvenation_steps=6, zeta=0.5)
"""Settings of the sampler where a rough likelihood leads near the posterior; moves by the exact one follow."""
PARTICLES = {1: 2000, 2: 2000, 3: 2000}
MANY_INPUTS_PARTICLES = 1200
TEMPERATURE = 0.5
"""γ of the sampled π_γ ∝ L^γ p; its particles are reweighted to the posterior, and runs are chosen from them."""
STREAM = 4
"""Keeps the random numbers of the active design apart from all others of the same seed."""
Points = Float[np.ndarray, "particle dim"]
Values = Float[np.ndarray, " particle"]
KEPT = 0.3
"""Least effective share of the last posterior's particles from which sampling goes on."""
ROUNDS = 2
"""Rounds of moves that follow."""
ELSEWHERE = 0.01
"""Largest share of the evidence that draws of the prior may find outside the last posterior's particles."""
OUTSIDE = 5.0
"""Distance from the mean, in standard deviations of the particles, from which a draw is outside."""


def posterior_state(
    knowledge: Knowledge,
    space: ParameterSpace,
    seed: tuple[int, ...],
    *,
    before: State | None = None,
    on_step: Callable[[StepInfo], None] | None = None,
) -> State:
    """Return the posterior that `knowledge` leads to; the same arguments give the same result to the bit.

    Args:
        knowledge: Knowledge from the runs.
        space: The inputs with their priors.
        seed: Seed of the random numbers, one or more integers.
        before: An earlier posterior to go on from, if the new one is near; None: sample from the prior.
        on_step: Called after every tempering step.
    """
    rng = np.random.default_rng([*seed, STREAM])
    number = PARTICLES.get(space.dim, MANY_INPUTS_PARTICLES)
    initial = space.prior_quantiles(rng.random((number, space.dim)))
    host = OnHost(lambda x: TEMPERATURE * knowledge.plug_in(x))
    key = jax.random.key(int(rng.integers(2**32)))
    with one_thread():
        if before is not None and len(before.positions) == number:
            found = _gone_on(host, space, _Sampled.of(before), initial, key)
            if found is not None:
                return _state(knowledge, found)
        if knowledge.roughly(initial[:1]) is not None:
            rough = OnHost(lambda x: TEMPERATURE * np.asarray(knowledge.roughly(x)))
            near = _from_prior(key, rough, space, initial, on_step, ROUGHLY)
            found = _gone_on(host, space, near, initial, jax.random.fold_in(key, 1))
            if found is not None:
                return _state(knowledge, found)
        return _state(knowledge, _from_prior(key, host, space, initial, on_step))


class _Sampled(NamedTuple):
    """Particles of π_γ.

    Attributes:
        positions: positions, shape (particle, dim).
        log_weights: normalised log weights.
        values: γ log L.
        log_evidence: log ∫ L^γ p dx.
    """

    positions: Points
    log_weights: Values
    values: Values
    log_evidence: float

    @classmethod
    def of(cls, state: State) -> "_Sampled":
        """Return the particles of a posterior that was sampled earlier."""
        values = TEMPERATURE * state.log_plug_in
        return cls(state.positions, state.log_weights_tempered, values, state.log_evidence_tempered)


def _from_prior(
    key: jax.Array,
    host: OnHost,
    space: ParameterSpace,
    initial: Points,
    on_step: Callable[[StepInfo], None] | None,
    settings: SMCSettings = SAMPLING,
) -> _Sampled:
    found = sample(key, host, space.log_prior, initial, settings=settings, on_step=on_step)
    return _Sampled(found.positions, found.log_weights, found.log_likelihood, found.log_evidence)


def _gone_on(
    host: OnHost, space: ParameterSpace, before: _Sampled, scouts: Float[np.ndarray, "scout dim"], key: jax.Array
) -> _Sampled | None:
    """Return the particles moved from another likelihood's to those of `host`; None if the two are not near."""
    x, values = before.positions, host(before.positions)
    weights = before.log_weights + values - before.values
    increment = float(logsumexp(weights))
    weights = weights - increment
    if not np.isfinite(increment) or 1.0 / np.exp(logsumexp(2 * weights)) < KEPT * len(x):
        return None
    log_evidence = before.log_evidence + increment
    mean, w = np.exp(weights) @ x, np.exp(weights)
    sd = np.sqrt(w @ (x - mean) ** 2)
    outside = (np.abs(scouts - mean) > OUTSIDE * np.maximum(sd, np.finfo(float).tiny)).any(axis=1)
    if not np.isfinite(log_evidence):
        return None
    if outside.any():
        found = logsumexp(host(scouts[outside])) - np.log(len(scouts)) - log_evidence
        if found > np.log(ELSEWHERE):
            return None
    state = Particles(
        jnp.asarray(x),
        jnp.asarray(weights),
        jnp.asarray(values),
        jax.jit(space.log_prior)(jnp.asarray(x)),
        jnp.ones(()),
        jnp.asarray(0.3),
        1e-8 * jnp.asarray(space.high - space.low),
    )
    for one in jax.random.split(key, ROUNDS):
        state = rejuvenate(one, state, host, space.log_prior, moves=SAMPLING.rejuvenation_steps // ROUNDS)
    moved = np.asarray(state.positions), np.asarray(state.log_weights), np.asarray(state.log_likelihood)
    return _Sampled(*moved, log_evidence)


def _state(knowledge: Knowledge, found: _Sampled) -> State:
    x, log_weights, tempered, log_evidence = found
    exact, expected = tempered / TEMPERATURE, knowledge.expected(x)
    rest = log_weights - tempered
    return State(
        knowledge=knowledge,
        positions=x,
        log_weights=log_softmax(rest + expected),
        log_weights_tempered=log_weights,
        log_weights_plug_in=log_softmax(rest + exact),
        log_expected=expected,
        log_plug_in=exact,
        log_evidence_tempered=log_evidence,
    )
