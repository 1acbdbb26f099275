"""Several runs of the sampler: two joined, or one carried over to another likelihood close by; and many side by side.

Those side by side are posteriors that differ only in given values, sampled in one compiled program.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key, UInt32
from scipy.special import logsumexp

from strandline.foundations import WIDEST, NumericsError, require, use_double
from strandline.smc.moves import NARROWEST, BatchedLogDensity, RandomKey, Scalar
from strandline.smc.on_host import advance_each_on_host, advance_on_host, is_on_host
from strandline.smc.records import SMCResult, SMCSettings, StepInfo
from strandline.smc.sampler import check, checked_start, finished, hashable, report, require_steps_left
from strandline.smc.steps import Info, Particles, advance

FEWEST = 4  # number of particles from which there are two halves that the sampler accepts
FIRST = 2  # keeps the keys of the halves apart from those derived from the same key elsewhere
KEPT = 0.3  # least effective share of the particles from which sampling goes on
ENOUGH = 0.9  # effective share from which the weights alone are good enough
ROUNDS = 2  # rounds of moves that follow otherwise
SCOUTS = 1000  # draws of the prior that are tried
OUTSIDE = 5.0  # distance from the mean, in standard deviations of the particles, from which a draw is outside
ELSEWHERE = 0.01  # largest share of the evidence that draws of the prior may find outside the particles
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
    rounds, always = jax.random.split(key, ROUNDS) if effective < ENOUGH else (), jnp.ones(())
    particles = jnp.asarray(x), jnp.asarray(weights), jnp.asarray(values), jax.jit(log_prior)(jnp.asarray(x))
    state = Particles(*particles, jnp.ones(()), jnp.asarray(FIRST_ACCEPTANCE), NARROWEST * jnp.asarray(extents))
    for one in rounds:  # always resampled, so that all weights are equal; moves leave L p invariant
        state, _ = advance_on_host(one, state, always, always, target=(log_likelihood, log_prior), moves=moves)
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


ConditionalLogDensity = Callable[[Float[Array, "particle dim"], Float[Array, " given"]], Float[Array, " particle"]]
"""log L(x | θ) of points x and one value of θ."""


def sample_each(
    key: RandomKey,
    log_likelihood: ConditionalLogDensity,
    log_prior: BatchedLogDensity,
    initial: Float[np.ndarray, "case particle dim"],
    given: Float[np.ndarray, "value given"],
    *,
    settings: SMCSettings,
) -> tuple[SMCResult, ...]:
    """Draw weighted particles from p(x | θ, Y) ∝ L(x | θ) p(x) for each row θ of `given`.

    Each case does what `sample` does with the key ``fold_in(key, case)`` and θ fixed: it has its own temperatures and
    stops once it reaches 1. θ is an argument of the compiled step, so one program serves all cases; do not use the key
    again. Both log densities take physical points and are jittable; log L, batched over the points, takes one θ and may
    be -inf, log p is normalised. If the attribute `on_host` of log L is true, it takes NumPy arrays: the points of all
    cases and as many rows of θ. The initial particles are draws from the prior for each case, physical.

    Raises:
        InvalidInput: the number of sets of initial particles is not that of θ, double precision is off, there are fewer
            than two particles, or one lies outside the prior.
        NumericsError: as for `sample`; the message names θ.
    """
    found = f"{len(initial)} sets for {len(given)} given values"
    words = "one set for each given value, and at least one", "Draw a set from the prior for each value."
    require(len(initial) == len(given) > 0, "initial particles of conditional posteriors", found, *words)
    target = hashable(log_likelihood), hashable(log_prior)
    values = jnp.asarray(given, float)
    keys = jax.vmap(partial(jax.random.fold_in, key))(jnp.arange(len(values)))
    host = is_on_host(log_likelihood)
    states = _start(*target, initial, values)
    shares = jnp.asarray(settings.zeta, float), jnp.asarray(settings.resample_below, float)
    steps: list[list[StepInfo]] = [[] for _ in given]
    for number in range(settings.maximum_steps + 1):
        before = np.asarray(states.temperature)
        active = np.flatnonzero(before < 1.0)
        if not active.size:
            break
        require_steps_left(number, settings, _one(states, active[0]))
        common: dict[str, Any] = {"target": target, "moves": settings.rejuvenation_steps}
        if host:
            now = jax.vmap(partial(jax.random.fold_in, data=number))(keys)
            states, infos = advance_each_on_host(now, states, given, *shares, **common)
        else:
            states, infos = _step(keys, number, states, values, *shares, **common)
        fetched = jax.tree.map(np.asarray, (states, infos))
        for i in active:
            state, info = _one(fetched, i)
            _told_with(given[i], check, info, float(before[i]), state)
            steps[i].append(report(state, info))
    return tuple(finished(_one(states, i), tuple(done), settings) for i, done in enumerate(steps))


@partial(jax.jit, static_argnames=("target", "moves"), compiler_options=WIDEST)
def _step(
    keys: Key[Array, " case"] | UInt32[Array, "case 2"],
    number: int | Array,
    states: Particles,
    given: Float[Array, "case given"],
    zeta: Scalar,
    resample_below: Scalar,
    *,
    target: tuple[ConditionalLogDensity, BatchedLogDensity],
    moves: int,
) -> tuple[Particles, Info]:
    log_likelihood, log_prior = target

    def one(key: RandomKey, state: Particles, theta: Float[Array, " given"]) -> tuple[Particles, Info]:
        """Advance one case; leave it as it is once γ = 1."""
        now, given_theta = jax.random.fold_in(key, number), (lambda x: log_likelihood(x, theta), log_prior)
        after, info = advance(now, state, zeta, resample_below, target=given_theta, moves=moves)
        return jax.tree.map(partial(jnp.where, state.temperature < 1.0), after, state), info

    advanced: tuple[Particles, Info] = jax.vmap(one)(keys, states, given)
    return advanced


def _start(
    log_likelihood: ConditionalLogDensity,
    log_prior: BatchedLogDensity,
    initial: Float[np.ndarray, "case particle dim"],
    given: Float[Array, "case given"],
) -> Particles:
    use_double()
    positions = jnp.asarray(initial, float)
    likelihood = _first_values(log_likelihood, positions, given)
    prior = jax.jit(jax.vmap(log_prior))(positions)
    cases = range(len(given))
    states = [_told_with(given[i], checked_start, positions[i], likelihood[i], prior[i]) for i in cases]
    stacked: Particles = jax.tree.map(lambda *parts: jnp.stack(parts), *states)
    return stacked


def _first_values(
    log_likelihood: Callable[..., Any], positions: Float[Array, "case particle dim"], given: Float[Array, "case given"]
) -> Float[Array, "case particle"]:
    if not is_on_host(log_likelihood):
        values: Array = jax.jit(jax.vmap(log_likelihood))(positions, given)
        return values
    x, number = np.asarray(positions), positions.shape[1]
    theta = np.repeat(np.asarray(given), number, axis=0)
    return jnp.asarray(log_likelihood(x.reshape(-1, x.shape[2]), theta)).reshape(-1, number)


def _one(tree: Any, case: Any) -> Any:
    return jax.tree.map(lambda a: a[case], tree)


def _told_with(theta: Any, function: Callable[..., Any], *arguments: Any) -> Any:
    """Call the function; if the numerics fail, say for which θ."""
    try:
        return function(*arguments)
    except NumericsError as error:
        raise NumericsError(f"given {np.asarray(theta).tolist()}: {error}") from error
