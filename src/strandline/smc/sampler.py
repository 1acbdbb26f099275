"""Adaptive tempered Sequential Monte Carlo (Willmann et al. 2022, Algorithm 1).

One tempering step is a pure, jitted function (key, state) -> (state, info); the loop over steps is plain Python.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float

from strandline.foundations import WIDEST, NumericsError, use_double
from strandline.smc.moves import NARROWEST, BatchedLogDensity, RandomKey
from strandline.smc.on_host import advance_on_host, is_on_host
from strandline.smc.records import SMCResult, SMCSettings, StepInfo, require
from strandline.smc.steps import Info, Particles, advance
from strandline.smc.tempering import effective_sample_size

_DEFAULT = SMCSettings()
_Function = TypeVar("_Function", bound=Callable[..., Any])
_step = partial(jax.jit, static_argnames=("target", "moves"), compiler_options=WIDEST)(advance)


def spread(positions: Float[Array, "particle dim"]) -> Float[Array, "particle dim"]:
    """Return the particles in equal parts on as many devices as divide them evenly; jitted functions then run there.

    A CPU is one device unless `jax_num_cpu_devices` is set before JAX is first used; the command line sets it.
    """
    devices = jax.devices()
    count = max(n for n in range(1, len(devices) + 1) if len(positions) % n == 0)
    if count == 1:
        return positions
    parts: Any = PartitionSpec("particle")  # type: ignore[no-untyped-call]
    spreading = NamedSharding(Mesh(np.array(devices[:count]), ("particle",)), parts)
    spread_out: Array = jax.device_put(positions, spreading)
    return spread_out


def sample(
    key: RandomKey,
    log_likelihood: BatchedLogDensity,
    log_prior: BatchedLogDensity,
    initial: Float[Array | np.ndarray, "particle dim"],
    *,
    settings: SMCSettings = _DEFAULT,
    on_step: Callable[[StepInfo], None] | None = None,
) -> SMCResult:
    """Draw weighted particles from the posterior ∝ L p; the same key reproduces them bit for bit.

    The step is compiled once for each pair of functions, number of moves and shape, so reuse the function objects
    between calls.

    Args:
        key: Random key; do not use it again.
        log_likelihood: log L of physical points, batched and jittable; -inf allowed. Its value is ignored where log p
            is -inf. If its attribute `on_host` is true, it takes and returns NumPy arrays, is never called where log p
            is -inf, and is not compiled.
        log_prior: log p of physical points, batched and jittable; it must be normalised if you need the evidence.
        initial: Draws from the prior, physical.
        settings: The sampler's settings.
        on_step: Function called after every tempering step.

    Raises:
        InvalidInput: double precision is off, there are fewer than two particles, or an initial particle lies outside
            the prior.
        NumericsError: the log-likelihood is NaN or +inf inside the prior, or -inf everywhere, or tempering does not
            end.
    """
    target = hashable(log_likelihood), hashable(log_prior)
    state = _start(*target, initial)
    shares = jnp.asarray(settings.zeta, float), jnp.asarray(settings.resample_below, float)
    advanced = partial(advance_on_host if is_on_host(log_likelihood) else _step, moves=settings.rejuvenation_steps)
    steps: list[StepInfo] = []
    while (before := float(state.temperature)) < 1.0:
        require_steps_left(len(steps), settings, state)
        state, info = advanced(jax.random.fold_in(key, len(steps)), state, *shares, target=target)
        check(info, before, state)
        steps.append(report(state, info))
        if on_step is not None:
            on_step(steps[-1])
    return finished(state, tuple(steps), settings)


def _start(
    log_likelihood: BatchedLogDensity, log_prior: BatchedLogDensity, initial: Float[Array | np.ndarray, "particle dim"]
) -> Particles:
    """Return the state at γ = 0 after checking all that can be checked."""
    use_double()
    positions = jnp.asarray(initial, float)
    if is_on_host(log_likelihood):
        values = jnp.asarray(log_likelihood(np.asarray(positions)))  # type: ignore[arg-type]
        return checked_start(positions, values, jax.jit(log_prior)(positions))
    positions = spread(positions)
    return checked_start(positions, jax.jit(log_likelihood)(positions), jax.jit(log_prior)(positions))


def checked_start(
    positions: Float[Array, "particle dim"], likelihood: Float[Array, " particle"], prior: Float[Array, " particle"]
) -> Particles:
    """Return the state at γ = 0 of particles whose log L and log p are known.

    Its arrays are spread over the devices as after each step; otherwise the first step would be compiled separately.
    """
    require(len(positions) >= 2, "number of particles", len(positions), "at least 2")
    values, outside = np.asarray(likelihood), int(np.count_nonzero(~np.isfinite(prior)))
    require(outside == 0, "initial particles outside the prior", outside, "none: draws from the prior itself")
    undefined = np.isnan(values) | np.isposinf(values)
    if undefined.any():
        where = int(np.argmax(undefined))
        raise NumericsError(
            f"the log-likelihood is {values[where]} at {positions[where].tolist()}. "
            "Fix the likelihood there, or return -inf where it is zero."
        )
    if np.isneginf(values).all():
        raise NumericsError(
            f"all {len(values)} initial particles have a likelihood of zero. "
            "Use more particles, larger noise, or a prior that covers the data."
        )
    log_weights = jnp.full_like(likelihood, -np.log(len(positions)))
    narrowest = NARROWEST * jnp.std(positions, axis=0)
    one = jnp.ones_like(jnp.max(narrowest))
    return Particles(positions, log_weights, likelihood, prior, 0 * one, one, narrowest)


def hashable(function: _Function) -> _Function:
    """Return the function itself if the compiler can cache it, else a stand-in for this call."""
    try:
        hash(function)
    except TypeError:
        stand_in: Any = lambda *arguments: function(*arguments)  # noqa: E731
        return stand_in  # type: ignore[no-any-return]
    return function


def check(info: Info, before: float, state: Particles) -> None:
    """Refuse a step that met undefined likelihoods or that did not advance."""
    if int(info.undefined) > 0:
        raise NumericsError(
            f"the log-likelihood was NaN or +inf at {int(info.undefined)} proposal(s) inside the prior "
            f"at temperature {float(state.temperature):.3g}. Return -inf where the likelihood is zero."
        )
    if not float(state.temperature) > before:
        raise NumericsError(
            f"the temperature stalls at {before:.6g}: one particle outweighs all others. "
            "State a larger noise or use more particles."
        )


def require_steps_left(done: int, settings: SMCSettings, state: Particles) -> None:
    """Give up once the maximum number of steps is reached."""
    if done >= settings.maximum_steps:
        raise NumericsError(
            f"{done} tempering steps reached only temperature {float(state.temperature):.4g}. "
            f"Lower zeta (now {settings.zeta}) or raise maximum_steps."
        )


def report(state: Particles, info: Info) -> StepInfo:
    """Return what a step did as plain numbers."""
    return StepInfo(
        temperature=float(state.temperature),
        ess=float(info.ess),
        acceptance=float(state.acceptance),
        resampled=bool(info.resampled),
        log_evidence_increment=float(info.log_evidence_increment),
        covariance_scale=float(info.covariance_scale),
    )


def finished(state: Particles, steps: tuple[StepInfo, ...], settings: SMCSettings) -> SMCResult:
    """Return the result of a state at γ = 1."""
    return SMCResult(
        positions=np.asarray(state.positions),
        log_weights=np.asarray(state.log_weights),
        log_likelihood=np.asarray(state.log_likelihood),
        log_prior=np.asarray(state.log_prior),
        log_evidence=sum(step.log_evidence_increment for step in steps),
        ess=float(effective_sample_size(state.log_weights)),
        steps=steps,
        likelihood_evaluations=len(state.positions) * (1 + settings.rejuvenation_steps * len(steps)),
    )
