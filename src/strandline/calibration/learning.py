"""The forward runs of a calibration and what they teach: surrogates of the log-likelihood, or of the field.

They also show outputs in steps: those of a simulator that prints few digits, or whose interface jumps from cell to cell
of its mesh.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline import design
from strandline.calibration.assess_fit import misfit_of
from strandline.calibration.best_fit import by_field, by_runs
from strandline.calibration.misfit import Effort, Misfit
from strandline.calibration.problem import Observer, Problem, Settings, Stopwatch
from strandline.calibration.targets import FieldTarget, LogLikelihoodTarget, Target
from strandline.foundations import NoCommonPoints, NumericsError, TooFewRuns, one_thread, require
from strandline.interface import Interface
from strandline.models import WithCheaper, asks_sensitivities, first_runs
from strandline.parameters import ParameterSpace
from strandline.posterior import Posterior
from strandline.runs import Executor, Ledger, RunRecord, counted, run_batches, run_campaign, usable_cores
from strandline.surrogate import MANY_INPUTS, LogLikelihoodSurrogate, fit_log_likelihood, fit_named, fit_of_the_user

Given = Float[np.ndarray, "run dim"] | Sequence[Mapping[str, float]]
"""The unknown inputs of runs, shape (run, dim), or all inputs of each by name."""
ROUNDS_INSTEAD = 4  # rounds of refinement that make the second half of an active design's runs if there can be no field


@dataclass(frozen=True, eq=False)
class TrainedSurrogate:
    """What was learnt from all forward runs.

    With a field, `knowledge`, the surrogates of the log-likelihood in `learnt` are for comparison; else it is None, and
    `no_field` says why if the settings ask for one. `certificate` and `sampled`, the last posterior, are an active
    design's, as `exact`, its draws of the true posterior, if there are any. `set_aside` are unused runs.
    """

    learnt: design.Learnt
    rounds: tuple[design.Round, ...] = ()
    knowledge: design.Knowledge | None = None
    certificate: design.Certificate | None = None
    sampled: design.State | None = None
    exact: design.ExactDraws | None = None
    no_field: str | None = None
    set_aside: tuple[design.SetAside, ...] = ()

    def target(self, space: ParameterSpace) -> Target:
        """Return the log-likelihood to sample: of the field if there is one, else of the first measure's surrogate."""
        surrogates = [one.process for one in self.learnt.surrogates.values()]
        if self.knowledge is None:
            return LogLikelihoodTarget(surrogates[0], space)
        known = self.knowledge.likelihood.inferred is None  # else they learnt the log-likelihood of a first guess
        beside = next(iter(surrogates), None) if known else None
        return FieldTarget(self.knowledge, space, self.certificate, beside, self.sampled, self.exact)

    def misfit(self, problem: Problem, posterior: Posterior, *, effort: Effort, seed: int) -> Misfit:
        """Return whether the model explains the observations within the noise, whatever the inputs."""
        observations, learnt, explained, fitted = problem.observations, self.learnt, None, False
        with one_thread():
            if self.knowledge is not None:
                prediction, inferred = by_field(self.knowledge.surrogate), self.knowledge.likelihood.inferred
                if inferred is not None:
                    fitted = any(o.unknown and not o.unknown.stated for o in observations)
                    observations, explained = inferred.at_median(observations), inferred.explained
            else:
                runs = learnt.training, [record for record in learnt.records if record.ok], learnt.log_likelihood
                prediction = by_runs(*runs, problem.space, observations, problem.measure, most=effort.runs)
            return misfit_of(
                prediction,
                observations,
                problem.measure,
                posterior,
                fixed=tuple(problem.fixed),
                explained=explained,
                fitted=fitted,
                effort=effort,
                seed=seed,
            )

    @property
    def found(self) -> dict[str, Any]:
        """What a `Calibration` reports about the runs, by the names of its fields."""
        of_runs = ("records", "made", "training", "log_likelihoods", "surrogates")
        return {name: getattr(self.learnt, name) for name in of_runs} | {
            name: getattr(self, name) for name in ("rounds", "no_field", "set_aside")
        }


@dataclass(frozen=True)
class Learning:
    """The forward runs and the surrogates of one calibration."""

    problem: Problem
    settings: Settings
    ledger: Ledger
    executor: Executor
    tell: Observer
    watch: Stopwatch

    @cached_property
    def judge(self) -> design.RunFilter:
        return design.RunFilter(self.problem.observations, self.problem.discrepancies, self.settings.failures)

    def train(self, given: Given | None) -> TrainedSurrogate:
        """Make all forward runs and learn from them, with the surrogate that the settings name if possible."""
        begin, runs = self._begin(given)
        if self.settings.surrogate == "log_likelihood":
            return self._refined(begin, self.settings.refine)
        choosing = None if self.settings.active is None else self._active(self.settings.active)
        if choosing is not None:
            choosing.design.start(begin, given=given is not None)
        try:
            learnt, knowledge = self._by_field(runs, choosing)
        except NoCommonPoints as error:
            if any(seen.unknown for seen in self.problem.observations):
                raise  # only a surrogate of the interface can infer the noise
            self.judge.forget_exceptions()
            asked = begin if choosing is None else choosing.asked
            return replace(self._instead(asked), no_field=str(error.value))
        trained = TrainedSurrogate(learnt, knowledge=knowledge, set_aside=self.judge.set_aside(learnt.records))
        if choosing is None:
            return trained
        sampled, exact = choosing.design.state, choosing.exact
        return replace(trained, certificate=choosing.certificate, sampled=sampled, exact=exact)

    def _begin(self, given: Given | None) -> tuple[Float[np.ndarray, "run dim"], list[dict[str, float]]]:
        if given is None:
            begin = self._first(self.settings.runs)
            return begin, first_runs(self.problem.model, self._inputs(begin))
        names = self.problem.space.names
        if isinstance(given, np.ndarray):
            right = given.ndim == 2 and given.shape[1] == len(names)
            require(right, "shape of the given runs", given.shape, f"(run, {len(names)})", "Give a row for each run.")
            return given, self._inputs(given)
        runs = [dict(entry) for entry in given]
        for entry in runs:
            missing = [name for name in names if name not in entry]
            require(not missing, "a given run", f"no {', '.join(missing)}", "all inputs of the run", "Add them.")
        rows = dict.fromkeys(tuple(entry[name] for name in names) for entry in runs)
        return np.array(list(rows), float), runs

    def _first(self, number: int) -> Float[np.ndarray, "run dim"]:
        space, scramble = self.problem.space, self.settings.scramble
        if self.settings.active is not None:
            return design.first_inputs(self.settings.active, space, number, scramble)
        return space.to_physical(design.sobol(number, space.dim, scramble=scramble))

    def _refined(self, first: Float[np.ndarray, "run dim"], refinement: design.Refinement) -> TrainedSurrogate:
        learnt, rounds = design.refine(
            self.extend(None, first),
            self.extend,
            self.problem.space,
            refinement,
            particles=self.settings.particles,
            seed=self.settings.seed,
            stage=lambda: self.watch("refinement", self.tell),
        )
        return TrainedSurrogate(learnt, rounds, set_aside=self.judge.set_aside(learnt.records))

    def _instead(self, asked: Float[np.ndarray, "run dim"]) -> TrainedSurrogate:
        """Learn the log-likelihood from the runs `asked` for so far and others: half of all are spread over the box."""
        most = len(asked) if self.settings.active is None else max(self.settings.active.runs, len(asked))
        more = max(most - ROUNDS_INSTEAD * (most // (2 * ROUNDS_INSTEAD)) - len(asked), 0)
        if more:
            made = {row.tobytes() for row in asked}  # runs that explore are of the same sequence
            spread = self._first(self.settings.runs + more + len(asked))[self.settings.runs :]
            further = spread[[row.tobytes() not in made for row in spread]][:more]
            self.tell.draws(self._inputs(further))
            asked = np.concatenate([asked, further])
        runs = (most - len(asked)) // ROUNDS_INSTEAD
        return self._refined(asked, design.Refinement(ROUNDS_INSTEAD, runs) if runs else design.Refinement())

    def extend(self, known: design.Learnt | None, points: Float[np.ndarray, "run dim"]) -> design.Learnt:
        """Run the model at `points`, append these to the known runs, and train the surrogates with all of them."""
        with self.watch("forward", self.tell):
            if known is not None:
                self.tell.draws(self._inputs(points))
            records = self._run(self._inputs(points), None)
        if known is not None:
            points, records = np.concatenate([known.design, points]), (*known.records, *records)
        with self.watch("surrogate", self.tell):
            records = self.judge.usable(records)
            _require_enough(records, self.problem.space.dim)
            training, log_likelihoods = _training_set(self.judge, points, records)
            surrogates = _trained(training, log_likelihoods, self.settings)
        return design.Learnt(points, records, training, log_likelihoods, surrogates)

    def _by_field(
        self, first: Sequence[Mapping[str, float]], choosing: design.ActiveRuns | None
    ) -> tuple[design.Learnt, design.Knowledge]:
        """Run the model at `first` and where the active design chooses; learn the field, and log L for comparison."""
        space = self.problem.space
        with self.watch("forward", self.tell):
            records = self._run(first, choosing)
        made = records if isinstance(self.problem.model, WithCheaper) else ()
        if choosing is None or choosing.fidelities is None:
            records = design.as_by_model(records, space.names)
        else:
            choosing.fidelities.learn(records)
            records = choosing.fidelities.records
        points = np.array([[record.inputs[name] for name in space.names] for record in records], float)
        with self.watch("surrogate", self.tell):
            if choosing is None or choosing.design.state is None:
                knowledge, records = known_field(points, records, self.judge, space)
            else:
                knowledge, records = choosing.design.state.knowledge, self.judge.usable(records)
            informed = choosing is not None and choosing.informed
            training, log_likelihoods = _training_set(self.judge, points, records)
            surrogates = {}
            if not (self.settings.draft or informed):
                with suppress(NumericsError, TooFewRuns):
                    surrogates = _trained(training, log_likelihoods, self.settings)
        return design.Learnt(points, records, training, log_likelihoods, surrogates, made), knowledge

    def _run(self, first: Sequence[Mapping[str, float]], choosing: design.ActiveRuns | None) -> tuple[RunRecord, ...]:
        model, inputs = self.problem.model, [dict(entry) for entry in first]
        common: dict[str, Any] = {"ledger": self.ledger, "executor": self.executor, "on_record": self.tell.run}
        common["policy"] = self.settings.failures
        if choosing is None:
            return run_campaign(model, inputs, **common)

        def choose(records: Sequence[RunRecord]) -> Sequence[Mapping[str, float]]:
            batch = choosing(records)
            if batch:
                self.tell.draws(batch)
            return batch

        patience = math.inf if choosing.informed else choosing.active.patience
        return run_batches(model, [inputs], choose, patience=patience, **common)

    def _active(self, active: design.Active) -> design.ActiveRuns:
        workers, model = getattr(self.executor, "workers", None) or usable_cores(), self.problem.model
        names = [seen.condition for seen in self.problem.observations]
        both = (
            design.Fidelities(self.problem.space.names, names, model.cost) if isinstance(model, WithCheaper) else None
        )
        return design.ActiveRuns(
            active=active,
            space=self.problem.space,
            discrepancy=self.problem.measure,
            batch=active.batch or min(max(workers, 2), design.LARGEST_BATCH),
            seed=self.settings.seed,
            scramble=self.settings.scramble,
            judge=self.judge,
            aside=lambda: self.watch("choice", self.tell),
            inputs=self._inputs,
            fidelities=both,
            on_step=self.tell.step,
            told=self.tell.batch,
            particles=design.DRAFT_PARTICLES if self.settings.draft else None,
            informed=both is None
            and (active.differences or asks_sensitivities(model))
            and self.problem.space.dim >= MANY_INPUTS,
        )

    def _inputs(self, points: Float[np.ndarray, "run dim"]) -> list[dict[str, float]]:
        return [{**self.problem.fixed, **self.problem.space.as_mapping(x)} for x in points]


def known_field(
    points: Float[np.ndarray, "run dim"], records: Sequence[RunRecord], judge: design.RunFilter, space: ParameterSpace
) -> tuple[design.Knowledge, tuple[RunRecord, ...]]:
    """Learn the field for the judge's first measure; also return the records, the unused ones as invalid.

    Raises:
        TooFewRuns: Too few runs can be used.
        NoCommonPoints: Interfaces that cannot be brought to common points.
    """
    measure = judge.discrepancies[judge.first]
    while True:
        used = judge.usable(records)
        _require_enough(used, space.dim, slopes=all(record.sensitivities for record in used if record.ok))
        try:
            return design.learn(points, used, space, judge.observations, measure), used
        except NoCommonPoints as error:
            judge.without_exceptions(records, error)


def _trained(
    training: Float[np.ndarray, "ok dim"], log_likelihoods: Mapping[str, Float[np.ndarray, " ok"]], settings: Settings
) -> dict[str, LogLikelihoodSurrogate]:
    """Return a surrogate for each measure, except those after the first that can compare too few runs."""
    found, fit = {}, partial(fit_log_likelihood, kernel=settings.kernel)
    if settings.fit is not None:
        fit = partial(fit_of_the_user, fit=fit_named(settings.fit))
    for name, values in log_likelihoods.items():
        usable = np.isfinite(values)
        if usable.all() or usable.sum() >= training.shape[1] + 2:
            found[name] = fit(training[usable], values[usable])
    return found


def _training_set(
    judge: design.RunFilter, points: Float[np.ndarray, "run dim"], records: Sequence[RunRecord]
) -> tuple[Float[np.ndarray, "ok dim"], dict[str, Float[np.ndarray, " ok"]]]:
    """Return the inputs of the usable runs and their log-likelihood under each measure, NaN if a run has none."""
    succeeded = [i for i, record in enumerate(records) if record.ok]
    values = {name: np.array([judge.value(name, records[i]) for i in succeeded]) for name in judge.likelihoods}
    return points[succeeded], values


def _require_enough(records: Sequence[RunRecord], dim: int, *, slopes: bool = False) -> None:
    """Refuse fewer successful runs than a surrogate needs; few are enough for a field if they have sensitivities."""
    succeeded, needed = sum(record.ok for record in records), 3 if slopes else dim + 2
    if succeeded >= needed:
        return
    kinds = Counter(record.failure_kind or record.state for record in records if not record.ok)
    shown = counted(dict(kinds.most_common(3))) or "none failed"
    last = next((record.message for record in records if record.message), "")
    look = f", or look at the failures with `strandline status`{'; e.g. ' + last.splitlines()[0] if last else '.'}"
    what = "every forward run failed" if succeeded == 0 else "too few successful forward runs"
    value, expected = f"{succeeded} of {len(records)} ({shown})", f"at least {needed} for {dim} input{'s' * (dim > 1)}"
    raise TooFewRuns(what, value=value, expected=expected, remedy=f"Enlarge the design{look if kinds else '.'}")


ALIKE = 0.5  # share of a run's values that other runs must meet too: of smooth outputs hardly any, 1 for few steps
ROUNDING = 1e-9  # share of their range by which equal values may differ
SMOOTH = 0.1
"""Residual of quadratics of the inputs, in steps, below which values are not rounded: rounding leaves 0.29. The inputs
of a Sobol design are fractions, and so are simple functions of them."""
FEW = 4
"""Most significant digits that count as few. In eight shapes, steps of four were 1e-4 of the range, on average; those
of five, 1e-5, are far below any noise."""


@dataclass(frozen=True)
class OutputSteps:
    """The distance of neighbouring values, mm, of one coordinate of an interface: x, y or z.

    Where values have few significant `digits` (else 0), it is the root mean square over the values: as much rounding
    as equal steps of that length make.
    """

    condition: str
    axis: str
    step: float
    digits: int


def steps_of(runs: Sequence[Mapping[str, Interface]], inputs: Float[np.ndarray, "run dim"]) -> list[OutputSteps]:
    """Return the coordinates that move from run to run but meet the same values again and again or have few digits.

    Numbers that follow the inputs smoothly do not repeat. Nothing is found if the runs differ in their number of points
    or if the inputs repeat themselves, as those of a grid do.
    """
    if any(len(np.unique(column)) < len(runs) for column in inputs.T):
        return []
    found = []
    for condition in runs[0]:
        shapes = [run[condition].points for run in runs]
        if len({shape.shape for shape in shapes}) > 1:
            continue
        for axis, values in zip("xyz", np.moveaxis(np.stack(shapes), -1, 0), strict=False):
            moving = values[:, np.ptp(values, axis=0) > 0]
            step, digits = max((_step(moving), 0), _few_digits(moving)) if moving.size else (0.0, 0)
            if step and _residual(moving, inputs) > SMOOTH * step:
                found.append(OutputSteps(condition, axis, step, digits))
    return found


def _step(values: Float[np.ndarray, "run node"]) -> float:
    """Return the typical distance of neighbouring values if runs share most of them, else 0."""
    whole = np.round(values / (ROUNDING * np.ptp(values)))
    met, times = np.unique(np.concatenate([np.unique(row) for row in whole]), return_counts=True)
    if times[times > 1].sum() < ALIKE * times.sum():
        return 0.0
    return float(np.median(np.diff(met))) * ROUNDING * float(np.ptp(values))


def _few_digits(values: Float[np.ndarray, "run node"]) -> tuple[float, int]:
    """Return the root mean square of the steps of values with few significant digits, and how many these are, else 0.

    A power of ten counts with the finer values below it: where a simulator has 1 exactly, that is no rounding.
    """
    sizes = np.abs(values[values != 0])
    for digits in range(1, FEW + 1):
        steps = 10.0 ** (np.ceil(np.log10(sizes) - ROUNDING) - digits)
        if np.allclose(sizes / steps, np.round(sizes / steps), rtol=ROUNDING, atol=0.0):
            return float(np.sqrt(np.mean(steps**2))), digits
    return 0.0, 0


def _residual(values: Float[np.ndarray, "run node"], inputs: Float[np.ndarray, "run dim"]) -> float:
    """Return the root mean square of what quadratic functions of the inputs leave of the values, or linear ones."""
    z = (inputs - inputs.mean(axis=0)) / inputs.std(axis=0)
    i, j = np.triu_indices(z.shape[1])
    terms = np.column_stack([np.ones(len(z)), z, z[:, i] * z[:, j]])
    if 2 * terms.shape[1] > len(z):
        terms = terms[:, : 1 + z.shape[1]]
    left = values - terms @ np.linalg.lstsq(terms, values)[0]
    return float(np.sqrt(np.mean(left**2)))
