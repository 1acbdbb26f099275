"""Several posteriors that differ only in given values, sampled side by side in one compiled program."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key, UInt32

from strandline.foundations import WIDEST, NumericsError, require, use_double
from strandline.smc.moves import BatchedLogDensity, RandomKey, Scalar
from strandline.smc.on_host import advance_each_on_host, is_on_host
from strandline.smc.records import SMCResult, SMCSettings, StepInfo
from strandline.smc.sampler import check, checked_start, finished, hashable, report, require_steps_left
from strandline.smc.steps import Info, Particles, advance

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
    again.

    Both log densities take physical points and are jittable; log L, batched over the points, takes one θ and may be
    -inf, log p is normalised. If the attribute `on_host` of log L is true, it takes NumPy arrays: the points of all
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
        after, info = advance(
            jax.random.fold_in(key, number),
            state,
            zeta,
            resample_below,
            target=(lambda x: log_likelihood(x, theta), log_prior),
            moves=moves,
        )
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
