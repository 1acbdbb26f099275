"""The whole method on one screen: from a problem to the posterior.

priors → Sobol design → forward runs → discrepancy → surrogate of the log-likelihood → tempered SMC → posterior.
"""

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from strandline.design import sobol
from strandline.discrepancy import Discrepancy
from strandline.errors import TooFewRuns
from strandline.interface import Observation
from strandline.likelihood import InterfaceLikelihood
from strandline.models.protocol import ForwardModel, require_conditions
from strandline.parameters import ParameterSpace
from strandline.posterior import (
    Cut,
    GaussianApproximation,
    LaplaceApproximation,
    Posterior,
    Reading,
    UnderUncertainty,
    laplace,
    log_prior_hessian,
    nuisance_values,
    pooled,
)
from strandline.quadrature import QuadratureResult, integrate
from strandline.runs import Executor, Ledger, Progress, RunRecord, run_campaign
from strandline.smc import (
    BatchedLogDensity,
    ConditionalLogDensity,
    SMCResult,
    SMCSettings,
    StepInfo,
    sample,
    sample_each,
)
from strandline.surrogate import LogLikelihoodSurrogate, batched_mean, fit_log_likelihood

__all__ = ["Calibration", "Observer", "Problem", "Settings", "calibrate"]

_CUT_ZETA = 0.5
"""Share of the effective sample size that a tempering step of the cut reading keeps: enough for moments."""
_CUT_PARTICLES = 250
"""Fewest particles for each value of the nuisance inputs: with 150, errors of 5 % of a standard deviation were seen."""
_CUT_STREAM = 2
"""Sets the random numbers of the cut reading apart from the two streams of the joint one."""


@dataclass(frozen=True)
class Problem:
    """What is asked.

    Args:
        model: the simulator.
        space: its unknown inputs with their priors.
        fixed: its known inputs by name.
        observations: the observed interface of each observed condition, and the noise.
        discrepancies: measures by name. The first one makes the posterior; the others get a surrogate to compare with.
    """

    model: ForwardModel
    space: ParameterSpace
    fixed: Mapping[str, float]
    observations: tuple[Observation, ...]
    discrepancies: Mapping[str, Discrepancy]


@dataclass(frozen=True)
class Settings:
    """How it is answered; the defaults are the study's.

    Args:
        runs: size of the Sobol design.
        scramble: seed of the design's scrambling, None for the plain sequence.
        kernel: of the Gaussian process.
        particles: of the sampler.
        smc: the sampler's other settings.
        seed: of every random number after the design.
        nuisance_values: values of the nuisance inputs, where there are any, that stand for their prior in the cut
            reading of the posterior under uncertainty.
    """

    runs: int = 1000
    scramble: int | None = None
    kernel: str = "matern32"
    particles: int = 5000
    smc: SMCSettings = field(default_factory=SMCSettings)
    seed: int = 1
    nuisance_values: int = 32


@dataclass(frozen=True)
class Calibration:
    """Problem, settings and all that was learnt.

    With nuisance inputs `posterior` is that of all inputs, `under_uncertainty` that of the calibrated ones, and
    `cut_quadrature` has one result for each value of the nuisance inputs; else both are None.
    """

    problem: Problem
    settings: Settings
    records: tuple[RunRecord, ...]
    training: Float[np.ndarray, "run dim"]
    log_likelihoods: Mapping[str, Float[np.ndarray, " run"]]
    surrogates: Mapping[str, LogLikelihoodSurrogate]
    sampling: SMCResult
    posterior: Posterior
    gaussian: GaussianApproximation
    laplace: LaplaceApproximation
    quadrature: QuadratureResult | None
    seconds: Mapping[str, float]
    under_uncertainty: UnderUncertainty | None = None
    cut_quadrature: tuple[QuadratureResult, ...] | None = None

    @property
    def surrogate(self) -> LogLikelihoodSurrogate:
        """The surrogate that made the posterior."""
        return next(iter(self.surrogates.values()))


@dataclass(frozen=True)
class Observer:
    """Who wants to know how far it is: functions called as the work goes on; by default nobody."""

    stage: Callable[[str], None] = lambda name: None
    run: Callable[[RunRecord, Progress], None] = lambda record, progress: None
    step: Callable[[StepInfo], None] = lambda info: None


def calibrate(
    problem: Problem,
    settings: Settings,
    *,
    ledger: Ledger,
    executor: Executor,
    observer: Observer | None = None,
) -> Calibration:
    """Return the posterior of the unknown inputs of `problem`.

    Finished runs in the ledger are not repeated. The same arguments give the same result to the bit, whatever order the
    runs ended in.

    Raises:
        InvalidInput: an observed condition that the model does not have; raised before any run.
        TooFewRuns: fewer successful runs than the Gaussian process needs.
    """
    require_conditions((o.condition for o in problem.observations), problem.model)
    watch, tell = _Stopwatch(), observer or Observer()
    space = problem.space
    with watch("forward", tell):
        design = space.to_physical(sobol(settings.runs, space.dim, scramble=settings.scramble))
        inputs = [{**problem.fixed, **space.as_mapping(x)} for x in design]
        records = run_campaign(problem.model, inputs, ledger=ledger, executor=executor, on_record=tell.run)
    with watch("surrogate", tell):
        training, log_likelihoods = _training_set(problem, design, records)
        surrogates = {
            name: fit_log_likelihood(training, values, kernel=settings.kernel)
            for name, values in log_likelihoods.items()
        }
        process = next(iter(surrogates.values())).process
    with watch("sampling", tell):
        start, chain = jax.random.split(jax.random.key(settings.seed))
        uniform = jax.random.uniform(start, (settings.particles, space.dim), dtype=float)
        initial = space.prior_quantiles(np.asarray(uniform))
        sampling = sample(
            chain, batched_mean(process), space.log_prior, initial, settings=settings.smc, on_step=tell.step
        )
        posterior = Posterior(
            space=space,
            draws=sampling.positions,
            log_weights=sampling.log_weights,
            log_likelihood=sampling.log_likelihood,
            log_prior=sampling.log_prior,
            log_evidence=sampling.log_evidence,
        )
    under_uncertainty = None
    if space.nuisance:
        with watch("cut", tell):
            given = _given(space, batched_mean(process))
            under_uncertainty = UnderUncertainty(Reading(posterior), _cut(space, given, settings))
    with watch("check", tell):
        mode = posterior.map_estimate
        hessian = process.hessian(mode[None])[0] + log_prior_hessian(space, mode)
        quadrature = _quadrature(space, process.mean)
        cut_quadrature = _cut_quadrature(given, under_uncertainty.cut) if under_uncertainty else None
    return Calibration(
        problem=problem,
        settings=settings,
        records=records,
        training=training,
        log_likelihoods=log_likelihoods,
        surrogates=surrogates,
        sampling=sampling,
        posterior=posterior,
        gaussian=GaussianApproximation(posterior.mean, posterior.covariance),
        laplace=laplace(hessian, mode),
        quadrature=quadrature,
        seconds=watch.seconds,
        under_uncertainty=under_uncertainty,
        cut_quadrature=cut_quadrature,
    )


def _training_set(
    problem: Problem, design: Float[np.ndarray, "run dim"], records: Sequence[RunRecord]
) -> tuple[Float[np.ndarray, "ok dim"], dict[str, Float[np.ndarray, " ok"]]]:
    """Return the inputs of the successful runs and their log-likelihood under each measure."""
    succeeded = [i for i, record in enumerate(records) if record.ok]
    interfaces = [records[i].interfaces for i in succeeded]
    _require_enough(len(succeeded), records, problem.space.dim)
    values = {}
    for name, discrepancy in problem.discrepancies.items():
        likelihood = InterfaceLikelihood(problem.observations, discrepancy)
        values[name] = np.array([likelihood(simulated) for simulated in interfaces])
    return design[succeeded], values


def _require_enough(succeeded: int, records: Sequence[RunRecord], dim: int) -> None:
    needed = dim + 2
    if succeeded >= needed:
        return
    kinds = Counter(record.failure_kind or record.state for record in records if not record.ok)
    shown = ", ".join(f"{kind}: {count}" for kind, count in kinds.most_common(3)) or "none failed"
    last = next((record.message for record in records if record.message), "")
    raise TooFewRuns(
        "every forward run failed" if succeeded == 0 else "too few successful forward runs",
        value=f"{succeeded} of {len(records)} ({shown}{'; e.g. ' + last.splitlines()[0] if last else ''})",
        expected=f"at least {needed} for a Gaussian process in {dim} dimension(s)",
        remedy="Enlarge the design, or look at the failures with `strandline status`.",
    )


def _quadrature(space: ParameterSpace, log_likelihood: Callable[[Any], Any]) -> QuadratureResult | None:
    """Integrate the same surrogate directly where the dimension allows it: the check of the sampler."""
    if space.dim > 3:
        return None
    return integrate(lambda x: log_likelihood(x) + space.log_prior(x), space.low, space.high)


def _given(space: ParameterSpace, log_likelihood: BatchedLogDensity) -> ConditionalLogDensity:
    """Return log L as a function of the calibrated inputs and of one value of the nuisance inputs."""
    order = np.argsort([*space.calibrated, *space.nuisance])

    def given(x: Float[jax.Array, "particle x"], theta: Float[jax.Array, " nuisance"]) -> Float[jax.Array, " particle"]:
        fixed = jnp.broadcast_to(theta, (len(x), len(theta)))
        return log_likelihood(jnp.concatenate([x, fixed], axis=1)[:, order])

    return given


def _cut(space: ParameterSpace, log_likelihood: ConditionalLogDensity, settings: Settings) -> Cut:
    """Sample p(x | θ, Y) for values θ that represent p(θ), as many particles in all as the study has, and pool them."""
    values, calibrated = nuisance_values(space, settings.nuisance_values), space.calibrated_space
    start, chain = jax.random.split(jax.random.fold_in(jax.random.key(settings.seed), _CUT_STREAM))
    each = max(_CUT_PARTICLES, -(-settings.particles // len(values)))
    uniform = jax.random.uniform(start, (len(values) * each, calibrated.dim), dtype=float)
    initial = calibrated.prior_quantiles(np.asarray(uniform)).reshape(len(values), each, -1)
    smc = replace(settings.smc, zeta=min(_CUT_ZETA, settings.smc.zeta))
    return pooled(
        space, values, sample_each(chain, log_likelihood, calibrated.log_prior, initial, values, settings=smc)
    )


def _cut_quadrature(log_likelihood: ConditionalLogDensity, cut: Cut) -> tuple[QuadratureResult, ...] | None:
    """Integrate p(x | θ, Y) directly for each θ of the cut reading, where the dimension allows it."""
    if cut.extended.space.dim > 3:
        return None
    calibrated, compiled = cut.extended.space.calibrated_space, jax.jit(log_likelihood)

    def log_density(x: Float[np.ndarray, "point x"], theta: Float[np.ndarray, " nuisance"]) -> Any:
        return np.asarray(compiled(x, theta)) + calibrated.log_prior(x)

    return tuple(integrate(partial(log_density, theta=theta), calibrated.low, calibrated.high) for theta in cut.values)


class _Stopwatch:
    """Seconds by stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str, observer: Observer) -> Iterator[None]:
        observer.stage(stage)
        begun = time.perf_counter()
        yield
        self.seconds[stage] = time.perf_counter() - begun
