"""The forward runs of a calibration and what they teach: surrogates of the log-likelihood, or of the field."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.active import Active, ActiveRuns, FieldOutcome, VarianceEffect, learn
from strandline.calibration import Observer, Problem, Settings, Stopwatch
from strandline.errors import NumericsError, TooFewRuns
from strandline.likelihood import InterfaceLikelihood
from strandline.refinement import Learnt
from strandline.runs import (
    Executor,
    Ledger,
    RunRecord,
    run_batches,
    run_campaign,
)
from strandline.runs.executors import usable_cores
from strandline.surrogate import LogLikelihoodSurrogate, fit_log_likelihood

__all__ = ["Learning"]

LARGEST_BATCH = 16
"""Runs of an active design chosen together where nobody says how many, at most."""


@dataclass(frozen=True)
class Learning:
    """The forward runs and the surrogates of one calibration."""

    problem: Problem
    settings: Settings
    ledger: Ledger
    executor: Executor
    tell: Observer
    watch: Stopwatch

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
