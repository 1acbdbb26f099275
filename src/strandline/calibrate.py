"""The whole method on one screen: from a problem to the posterior.

priors → Sobol design → forward runs → discrepancy → surrogate of the log-likelihood (→ further runs where the posterior
lies → better surrogate) → tempered SMC → posterior. Or: forward runs → surrogate of the interface as a field (→ batches
chosen on the posterior so far) → discrepancy of the predicted interface → tempered SMC → posterior.
"""

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import jax
import numpy as np
from jaxtyping import Float
from scipy.special import log_softmax, logsumexp

from strandline.active import Active, ActiveRuns, FieldOutcome, VarianceEffect, learn
from strandline.cut import cut_by_quadrature, cut_reading
from strandline.design import sobol
from strandline.discrepancy import Discrepancy
from strandline.errors import NumericsError, TooFewRuns
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
from strandline.runs import (
    Executor,
    FailurePolicy,
    Ledger,
    Progress,
    RunRecord,
    run_batches,
    run_campaign,
)
from strandline.runs.executors import usable_cores
from strandline.smc import (
    SMCResult,
    SMCSettings,
    StepInfo,
    sample,
)
from strandline.surrogate import LogLikelihoodSurrogate, fit_log_likelihood
from strandline.surrogate.field import one_thread
from strandline.targets import Target, of_field, of_process

__all__ = ["Calibration", "Observer", "Problem", "Settings", "calibrate"]

LARGEST_BATCH = 16
"""Runs of an active design chosen together where nobody says how many, at most."""


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
        surrogate: of what: of the log-likelihood, as the study has it, or of the interface as a ``field``.
        active: further runs chosen as the posterior takes shape; with a surrogate of the field only.
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
    surrogate: Literal["log_likelihood", "field"] = "log_likelihood"
    active: Active | None = None

    @property
    def planned_runs(self) -> int:
        """Runs of the Sobol design and of all rounds of refinement; of an active design, the most that it may make."""
        return self.runs + self.refine.total if self.active is None else self.active.runs


@dataclass(frozen=True)
class Calibration:
    """Problem, settings and all that was learnt; the runs of each round of refinement stand behind the earlier ones.

    With nuisance inputs `posterior` is that of all inputs, `under_uncertainty` that of the calibrated ones, and
    `cut_quadrature` has one result for each value of the nuisance inputs; else both are None. With a surrogate of the
    field, `field` is what it knows; `surrogates`, of the log-likelihood, are then there to compare, or empty.
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
    field: FieldOutcome | None = None

    @property
    def surrogate(self) -> LogLikelihoodSurrogate:
        """The surrogate of the log-likelihood under the first measure."""
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
    given: Float[np.ndarray, "run dim"] | None = None,
) -> Calibration:
    """Return the posterior of the unknown inputs of `problem`.

    With a surrogate of the field, `given` are the inputs of finished runs to begin with in place of a design.

    Finished runs in the ledger are not repeated. The same arguments give the same result to the bit, whatever order the
    runs ended in.

    Raises:
        InvalidInput: an observed condition that the model does not have; raised before any run.
        CampaignStopped: as `settings.failures` says; what is finished is in the ledger.
        TooFewRuns: fewer successful runs than the Gaussian process needs.
    """
    require_conditions((o.condition for o in problem.observations), problem.model)
    watch, tell = _Stopwatch(), observer or Observer()
    work = _Work(problem, settings, ledger, executor, tell, watch)
    space, field_ = problem.space, None
    rounds: tuple[Round, ...] = ()
    first = space.to_physical(sobol(settings.runs, space.dim, scramble=settings.scramble))
    if settings.surrogate == "field":
        learnt, field_ = work.by_field(first if given is None else given, given=given is not None)
        target = of_field(field_.knowledge, space)
    else:
        learnt, rounds = refine(
            work.extend(None, first),
            work.extend,
            space,
            settings.refine,
            particles=settings.particles,
            seed=settings.seed,
            stage=lambda: watch("refinement", tell),
        )
        target = of_process(learnt.surrogate.process)
    with watch("sampling", tell), nullcontext() if field_ is None else one_thread():
        sampling = _sample(target, space, settings, tell)
        posterior = _posterior(space, sampling, target)
    under_uncertainty = None
    if space.nuisance:
        with watch("cut", tell):
            cut = cut_reading(
                space,
                target.compiled,
                values=settings.nuisance_values,
                particles=settings.particles,
                smc=settings.smc,
                seed=settings.seed,
            )
            under_uncertainty = UnderUncertainty(Reading(posterior), cut)
    with watch("check", tell):
        mode = posterior.map_estimate
        hessian = target.hessian(mode, posterior.sd) + log_prior_hessian(space, mode)
        direct = field_ is None
        quadrature = _quadrature(space, jax.jit(target.compiled)) if direct else None
        cut_quadrature = cut_by_quadrature(target.compiled, cut) if under_uncertainty and direct else None
        sensitivity = _sensitivity(space, target.values, settings.seed)
        if field_ is not None:
            field_ = _described(field_, learnt, space, sampling, posterior, settings)
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
        field=field_,
    )


@dataclass(frozen=True)
class _Work:
    """The forward runs and the surrogates of one calibration."""

    problem: Problem
    settings: Settings
    ledger: Ledger
    executor: Executor
    tell: Observer
    watch: "_Stopwatch"

    def extend(self, known: Learnt | None, points: Float[np.ndarray, "run dim"]) -> Learnt:
        """Run the model at `points`, behind the known runs, and train the surrogates with all of them."""
        with self.watch("forward", self.tell):
            if known is not None:
                self.tell.draws(self._inputs(points))
            records = run_campaign(
                self.problem.model,
                self._inputs(points),
                ledger=self.ledger,
                executor=self.executor,
                on_record=self.tell.run,
                policy=self.settings.failures,
            )
        if known is not None:
            points, records = np.concatenate([known.design, points]), (*known.records, *records)
        with self.watch("surrogate", self.tell):
            training, log_likelihoods = _training_set(self.problem, points, records)
            surrogates = {
                name: fit_log_likelihood(training, values, kernel=self.settings.kernel)
                for name, values in log_likelihoods.items()
            }
        return Learnt(points, records, training, log_likelihoods, surrogates)

    def by_field(self, first: Float[np.ndarray, "run dim"], *, given: bool) -> tuple[Learnt, FieldOutcome]:
        """Run the model at `first`, and where the active design wants; learn the field.

        The surrogates of the log-likelihood are trained beside it, to compare, where they can be.
        """
        active, space = self.settings.active, self.problem.space
        choosing = None if active is None else self._active(active)
        if choosing is not None:
            choosing.design.start(first, given=given)
        with self.watch("forward", self.tell):
            records = self._run(first, choosing)
        points = np.array([[record.inputs[name] for name in space.names] for record in records], float)
        with self.watch("surrogate", self.tell):
            training, log_likelihoods = _training_set(self.problem, points, records)
            if choosing is None or choosing.design.state is None:
                (measure, *_), seen = self.problem.discrepancies.values(), self.problem.observations
                knowledge = learn(points, records, space, seen, measure)
            else:
                knowledge = choosing.design.state.knowledge
            surrogates = _to_compare(training, log_likelihoods, self.settings.kernel)
        learnt = Learnt(points, records, training, log_likelihoods, surrogates)
        none = VarianceEffect(np.zeros(space.dim), np.ones(space.dim), 1.0)
        certificate = None if choosing is None else choosing.certificate
        return learnt, FieldOutcome(knowledge, none, 1.0, certificate)

    def _run(self, first: Float[np.ndarray, "run dim"], choosing: ActiveRuns | None) -> tuple[RunRecord, ...]:
        model, inputs = self.problem.model, self._inputs(first)
        common: dict[str, Any] = {
            "ledger": self.ledger,
            "executor": self.executor,
            "on_record": self.tell.run,
            "policy": self.settings.failures,
        }
        if choosing is None:
            return run_campaign(model, inputs, **common)

        def choose(records: Sequence[RunRecord]) -> Sequence[Mapping[str, float]]:
            batch = self._inputs(choosing(records))
            if batch:
                self.tell.draws(batch)
            return batch

        return run_batches(model, [inputs], choose, patience=choosing.active.patience, **common)

    def _active(self, active: Active) -> ActiveRuns:
        workers = getattr(self.executor, "workers", None) or usable_cores()
        return ActiveRuns(
            active=active,
            space=self.problem.space,
            observations=self.problem.observations,
            discrepancy=next(iter(self.problem.discrepancies.values())),
            batch=active.batch or min(max(workers, 2), LARGEST_BATCH),
            seed=self.settings.seed,
            scramble=self.settings.scramble,
            aside=lambda: self.watch("choice", self.tell),
        )

    def _inputs(self, points: Float[np.ndarray, "run dim"]) -> list[dict[str, float]]:
        return [{**self.problem.fixed, **self.problem.space.as_mapping(x)} for x in points]


def _sample(target: Target, space: ParameterSpace, settings: Settings, tell: Observer) -> SMCResult:
    start, chain = jax.random.split(jax.random.key(settings.seed))
    uniform = jax.random.uniform(start, (settings.particles, space.dim), dtype=float)
    initial = space.prior_quantiles(np.asarray(uniform))
    return sample(chain, target.compiled, space.log_prior, initial, settings=settings.smc, on_step=tell.step)


def _posterior(space: ParameterSpace, sampling: SMCResult, target: Target) -> Posterior:
    """Return the draws, weighted from the log-likelihood that was sampled to the one that is meant."""
    log_likelihood, log_weights = sampling.log_likelihood, sampling.log_weights
    log_evidence = sampling.log_evidence
    if target.weighted is not None:
        meant = target.weighted(sampling.positions)
        log_weights = log_weights + meant - log_likelihood
        log_evidence += float(logsumexp(log_weights))
        log_likelihood, log_weights = meant, log_softmax(log_weights)
    return Posterior(
        space=space,
        draws=sampling.positions,
        log_weights=log_weights,
        log_likelihood=log_likelihood,
        log_prior=sampling.log_prior,
        log_evidence=log_evidence,
    )


def _described(
    found: FieldOutcome,
    learnt: Learnt,
    space: ParameterSpace,
    sampling: SMCResult,
    posterior: Posterior,
    settings: Settings,
) -> FieldOutcome:
    """Return the outcome with what the posterior says of the surrogate's variance, of feasibility, of the other way."""
    weights = np.exp(sampling.log_weights)
    mean = weights @ sampling.positions
    sd = np.sqrt(weights @ (sampling.positions - mean) ** 2)
    ratios = posterior.weights / np.maximum(weights, 1e-300)
    effective = float(1.0 / (weights @ ratios**2))
    effect = VarianceEffect((posterior.mean - mean) / posterior.sd, posterior.sd / sd, effective)
    feasible = float(posterior.weights @ np.exp(found.knowledge.log_feasibility(posterior.draws)))
    compared = None
    if learnt.surrogates:
        other = _sample(of_process(learnt.surrogate.process), space, settings, Observer())
        w = np.exp(other.log_weights)
        centre = w @ other.positions
        compared = {"mean": centre, "sd": np.sqrt(w @ (other.positions - centre) ** 2)}
    return replace(found, effect=effect, feasible=feasible, compared=compared)


def _to_compare(
    training: Float[np.ndarray, "ok dim"], log_likelihoods: Mapping[str, Float[np.ndarray, " ok"]], kernel: str
) -> dict[str, LogLikelihoodSurrogate]:
    """Return the surrogates of the log-likelihood, none where one cannot be trained."""
    try:
        return {name: fit_log_likelihood(training, v, kernel=kernel) for name, v in log_likelihoods.items()}
    except (NumericsError, TooFewRuns):
        return {}


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
    """Seconds by stage, added up where a stage comes again; a stage inside another one does not count there."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.within: list[str] = []

    @contextmanager
    def __call__(self, stage: str, observer: Observer) -> Iterator[None]:
        observer.stage(stage)
        self.within.append(stage)
        begun = time.perf_counter()
        yield
        taken = time.perf_counter() - begun
        self.within.pop()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + taken
        if self.within:
            outer = self.within[-1]
            self.seconds[outer] = self.seconds.get(outer, 0.0) - taken
            observer.stage(outer)
