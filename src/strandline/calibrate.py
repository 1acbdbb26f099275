"""The whole method on one screen: from a problem to the posterior.

priors → Sobol design → forward runs → discrepancy → surrogate of the log-likelihood (→ further runs where the posterior
lies → better surrogate) → tempered SMC → posterior.
"""

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from strandline.cut import cut_by_quadrature, cut_reading
from strandline.design import sobol
from strandline.discrepancy import Discrepancy
from strandline.errors import TooFewRuns
from strandline.interface import Observation
from strandline.likelihood import InterfaceLikelihood
from strandline.models.protocol import ForwardModel, require_conditions
from strandline.parameters import ParameterSpace
from strandline.posterior import (
    GaussianApproximation,
    LaplaceApproximation,
    Posterior,
    Reading,
    SobolIndices,
    UnderUncertainty,
    laplace,
    log_prior_hessian,
    sobol_indices,
)
from strandline.quadrature import QuadratureResult, integrate
from strandline.refinement import Learnt, Refinement, Round, refine
from strandline.runs import Executor, FailurePolicy, Ledger, Progress, RunRecord, run_campaign
from strandline.smc import (
    SMCResult,
    SMCSettings,
    StepInfo,
    sample,
)
from strandline.surrogate import LogLikelihoodSurrogate, batched_mean, fit_log_likelihood

__all__ = ["Calibration", "Observer", "Problem", "Settings", "calibrate"]


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
        refine: further runs where the posterior lies; none by default.
        kernel: of the Gaussian process.
        particles: of the sampler.
        smc: the sampler's other settings.
        seed: of every random number after the design.
        nuisance_values: values of the nuisance inputs, where there are any, that stand for their prior in the cut
            reading of the posterior under uncertainty.
        failures: what is done about forward runs that fail.
    """

    runs: int = 1000
    scramble: int | None = None
    refine: Refinement = field(default_factory=Refinement)
    kernel: str = "matern32"
    particles: int = 5000
    smc: SMCSettings = field(default_factory=SMCSettings)
    seed: int = 1
    nuisance_values: int = 32
    failures: FailurePolicy = field(default_factory=FailurePolicy)

    @property
    def planned_runs(self) -> int:
        """Runs of the Sobol design and of all rounds of refinement."""
        return self.runs + self.refine.total


@dataclass(frozen=True)
class Calibration:
    """Problem, settings and all that was learnt; the runs of each round of refinement stand behind the earlier ones.

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
    rounds: tuple[Round, ...] = ()
    sensitivity: SobolIndices | None = None

    @property
    def surrogate(self) -> LogLikelihoodSurrogate:
        """The surrogate that made the posterior."""
        return next(iter(self.surrogates.values()))


@dataclass(frozen=True)
class Observer:
    """Who wants to know how far it is: functions called as the work goes on; by default nobody.

    `draws` hears of the inputs of each round of refinement before they are run.
    """

    stage: Callable[[str], None] = lambda name: None
    draws: Callable[[Sequence[Mapping[str, float]]], None] = lambda inputs: None
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
        CampaignStopped: as `settings.failures` says; what is finished is in the ledger.
        TooFewRuns: fewer successful runs than the Gaussian process needs.
    """
    require_conditions((o.condition for o in problem.observations), problem.model)
    watch, tell = _Stopwatch(), observer or Observer()
    space = problem.space

    def extend(known: Learnt | None, points: Float[np.ndarray, "run dim"]) -> Learnt:
        """Run the model at `points`, behind the known runs, and train the surrogates with all of them."""
        inputs = [{**problem.fixed, **space.as_mapping(x)} for x in points]
        with watch("forward", tell):
            if known is not None:
                tell.draws(inputs)
            records = run_campaign(
                problem.model,
                inputs,
                ledger=ledger,
                executor=executor,
                on_record=tell.run,
                policy=settings.failures,
            )
        with watch("surrogate", tell):
            if known is not None:
                points, records = np.concatenate([known.design, points]), (*known.records, *records)
            training, log_likelihoods = _training_set(problem, points, records)
            surrogates = {
                name: fit_log_likelihood(training, values, kernel=settings.kernel)
                for name, values in log_likelihoods.items()
            }
        return Learnt(points, records, training, log_likelihoods, surrogates)

    learnt = extend(None, space.to_physical(sobol(settings.runs, space.dim, scramble=settings.scramble)))
    learnt, rounds = refine(
        learnt,
        extend,
        space,
        settings.refine,
        particles=settings.particles,
        seed=settings.seed,
        stage=lambda: watch("refinement", tell),
    )
    process = learnt.surrogate.process
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
            cut = cut_reading(
                space,
                batched_mean(process),
                values=settings.nuisance_values,
                particles=settings.particles,
                smc=settings.smc,
                seed=settings.seed,
            )
            under_uncertainty = UnderUncertainty(Reading(posterior), cut)
    with watch("check", tell):
        mode = posterior.map_estimate
        hessian = process.hessian(mode[None])[0] + log_prior_hessian(space, mode)
        quadrature = _quadrature(space, process.mean)
        cut_quadrature = cut_by_quadrature(batched_mean(process), cut) if under_uncertainty else None
        sensitivity = _sensitivity(space, process.mean, settings.seed)
    return Calibration(
        problem=problem,
        settings=settings,
        records=learnt.records,
        training=learnt.training,
        log_likelihoods=learnt.log_likelihoods,
        surrogates=learnt.surrogates,
        sampling=sampling,
        posterior=posterior,
        gaussian=GaussianApproximation(posterior.mean, posterior.covariance),
        laplace=laplace(hessian, mode),
        quadrature=quadrature,
        seconds=watch.seconds,
        under_uncertainty=under_uncertainty,
        cut_quadrature=cut_quadrature,
        rounds=rounds,
        sensitivity=sensitivity,
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


def _sensitivity(space: ParameterSpace, log_likelihood: Callable[[Any], Any], seed: int) -> SobolIndices | None:
    """Return what the inputs have to do with the log-likelihood; None where there is one input only."""
    if space.dim == 1:
        return None
    return sobol_indices(log_likelihood, space, number=2048 if space.dim < 4 else 1024, seed=seed)


class _Stopwatch:
    """Seconds by stage, added up where a stage comes again."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str, observer: Observer) -> Iterator[None]:
        observer.stage(stage)
        begun = time.perf_counter()
        yield
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - begun
