"""The evidence for the claims: the studies, the true posteriors, the convergence in seven inputs."""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from verification.reproduction.convergence import STUDY_SIZES, Convergence, convergence_study
from verification.reproduction.field_table import FieldTable, TableErrors, tabulate, withheld
from verification.reproduction.grid_posterior import GridPosterior, Reading
from verification.reproduction.larger_designs import LARGER, LargerDesign, larger_designs
from verification.reproduction.nested import SIZES, NestedDesign, NestedStep, nested_surrogates
from verification.reproduction.truth import TruePosterior, true_fields, true_posterior

from strandline.calibration import Observer
from strandline.design import sobol
from strandline.errors import InvalidInput
from strandline.likelihood import InterfaceLikelihood
from strandline.models.fingerprint import fingerprint
from strandline.runs import Executor, Ledger, run_campaign, run_key
from strandline.studies import Outcome, PosteriorCheck, Study, check_posterior, load_study, run_study

__all__ = ["RULES", "STUDIES", "Cost", "Evidence", "Plan", "Truths", "gather", "require_studies"]

STUDIES = (
    "biofilm-uniform",
    "biofilm-uniform-refined",
    "biofilm-informed",
    "biofilm-measures",
    "biofilm-inflow",
    "biofilm-inflow-refined",
    "biofilm-parts",
    "biofilm-parts-refined",
    "biofilm-parts-iterated",
)
"""Study folders, in an order that has the runs ready that each reuses."""
RULES = {"centre": "", "refined": "-refined"}
"""Ends of the folder's names by quadrature of the currents."""


@dataclass(frozen=True)
class Plan:
    """The extent of the work in addition to the studies themselves.

    Args:
        table: Intervals of the table of interfaces in load, ν and V, even.
        nodes: Nodes of the log-likelihood in load, ν and V.
        checks: Number of runs outside the table's data, to measure its error.
        nested: Sizes of the designs of S2.
        larger: Sizes of the designs of S5 whose runs are read from the table.
        sizes: Sizes of the training sets of Fig. 12.
        tests: Number of test points of Fig. 12, later points of the sequence.
        draws: Number of draws of each check of a posterior.
    """

    table: tuple[int, int, int] = (6, 10, 8)
    nodes: tuple[int, int, int] = (97, 41, 33)
    checks: int = 60
    nested: tuple[int, ...] = SIZES
    larger: tuple[int, ...] = LARGER
    sizes: tuple[int, ...] = STUDY_SIZES
    tests: int = 100
    draws: int = 200


@dataclass(frozen=True, eq=False)
class Truths:
    """Posteriors of the true model, by quadrature of the measure.

    Args:
        table: Table of the interfaces.
        errors: Errors of the table at runs that it was not made from.
        certain: Posterior with known inflow (S3).
        joint: Posterior with uncertain inflow (S5), which the data update.
        cut: Posterior with uncertain inflow, which the data do not update.
    """

    table: FieldTable
    errors: TableErrors
    certain: Mapping[str, TruePosterior]
    joint: Mapping[str, TruePosterior]
    cut: Mapping[str, TruePosterior]


@dataclass(frozen=True)
class Cost:
    """Forward runs made, forward runs found in ledgers, and seconds by stage, for one part of the work."""

    name: str
    made: int
    reused: int
    seconds: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Evidence:
    """The whole evidence.

    Args:
        studies: Loaded studies by name.
        outcomes: Outcomes of the studies.
        checks: Checks of posteriors with the true model, by study.
        truths: Posteriors of the true model.
        nested: Nested designs of S2, by quadrature rule.
        larger: Larger designs of S5, by quadrature rule.
        convergence: Convergence of Fig. 12, by quadrature rule.
        costs: Costs in the order of the work.
    """

    studies: Mapping[str, Study]
    outcomes: Mapping[str, Outcome]
    checks: Mapping[str, PosteriorCheck]
    truths: Truths
    nested: Mapping[str, tuple[NestedStep, ...]]
    larger: Mapping[str, tuple[LargerDesign, ...]]
    convergence: Mapping[str, Convergence]
    costs: tuple[Cost, ...]


CHECKED = (
    "biofilm-uniform",
    "biofilm-uniform-refined",
    "biofilm-inflow",
    "biofilm-inflow-refined",
    "biofilm-parts",
    "biofilm-parts-refined",
    "biofilm-parts-iterated",
)


def gather(folder: Path, results: Path, *, plan: Plan, executor: Executor | None, observer: Observer) -> Evidence:
    """Run all studies and all comparisons; finished forward runs are not repeated.

    Args:
        folder: Folder that holds the folders of `STUDIES`.
        results: Folder of the ledgers of further runs.
        plan: Extent of the work.
        executor: Executor of forward runs; by default that of the studies.
        observer: Observer of the progress.

    Raises:
        InvalidInput: A study is missing; also everything that `run_study` raises.
    """
    require_studies(folder)
    studies = {name: load_study(folder / name) for name in STUDIES}
    costs: list[Cost] = []
    outcomes = {}
    for name, study in studies.items():
        observer.stage(name)
        outcomes[name] = run_study(study, executor=executor, observer=observer)
        summary = outcomes[name].summary
        costs.append(Cost(name, summary["runs"]["new"], summary["runs"]["reused"], summary["seconds"]))
    checks = {}
    for name in CHECKED:
        observer.stage(f"{name}: check")
        found = check_posterior(studies[name], draws=plan.draws, executor=executor, observer=observer)
        runs = found.content["runs"]
        costs.append(Cost(f"{name}: check", runs["new"], runs["reused"], {"check": found.content["seconds"]}))
        checks[name] = found
    observer.stage("true posteriors")
    with _timed(costs, "true posteriors") as made:
        truths = _truths(studies, outcomes, results, plan, executor, observer, made)
    observer.stage("nested designs")
    with _timed(costs, "nested designs"):
        nested = {
            rule: nested_surrogates(
                _design(outcomes[f"biofilm-uniform{end}"]),
                truths.certain[rule].posterior,
                studies["biofilm-uniform"].space,
                sizes=plan.nested,
            )
            for rule, end in RULES.items()
        }
    observer.stage("larger designs in three inputs")
    with _timed(costs, "larger designs in three inputs"):
        larger = {rule: _larger(studies[f"biofilm-inflow{end}"], truths, rule, plan) for rule, end in RULES.items()}
    observer.stage("training size in seven inputs")
    with _timed(costs, "training size in seven inputs") as made:
        convergence = _convergence(studies, outcomes, results, plan, executor, observer, made)
    return Evidence(studies, outcomes, checks, truths, nested, larger, convergence, tuple(costs))


def require_studies(folder: Path) -> None:
    """Refuse a folder that lacks one of `STUDIES`.

    Raises:
        InvalidInput: One is missing; the message lists all missing ones.
    """
    missing = [name for name in STUDIES if not (folder / name / "study.yaml").is_file()]
    if missing:
        raise InvalidInput(
            "folder of the studies to reproduce",
            value=f"{folder}, without {', '.join(missing)}",
            expected="the folder `studies` of the project",
            remedy="Go to the root of the project, or say where it is with --studies.",
        )


@dataclass
class _Runs:
    """Counts the runs of a part."""

    made: int = 0
    reused: int = 0

    def count(self, ledger: Ledger, model: Any, inputs: list[dict[str, float]]) -> None:
        """Count how many of `inputs` the ledger already holds."""
        keys = {run_key(fingerprint(model), entry) for entry in inputs}
        known = len(ledger.latest(keys))
        self.made, self.reused = self.made + len(keys) - known, self.reused + known


@contextmanager
def _timed(costs: list[Cost], name: str) -> Iterator[_Runs]:
    begun, runs = time.perf_counter(), _Runs()
    yield runs
    costs.append(Cost(name, runs.made, runs.reused, {"in all": time.perf_counter() - begun}))


def _truths(
    studies: Mapping[str, Study],
    outcomes: Mapping[str, Outcome],
    results: Path,
    plan: Plan,
    executor: Executor | None,
    observer: Observer,
    made: _Runs,
) -> Truths:
    study = studies["biofilm-uniform"]
    model: Any = study.model
    chosen = executor or study.executor
    with Ledger.open(results / "table.sqlite", model=model, description="table of interfaces") as ledger:
        before = ledger.counts().total
        table = tabulate(model, model.undeformed(), intervals=plan.table, ledger=ledger, executor=chosen)
        errors = withheld(table, model, _between(table, plan.checks), ledger=ledger, executor=chosen)
        made.made = ledger.counts().total - before
        made.reused = table.runs + plan.checks - made.made
    rate = study.fixed["V_in"]
    certain, joint, cut = {}, {}, {}
    for rule, end in RULES.items():
        likelihood = _likelihood(outcomes[f"biofilm-uniform{end}"])
        space, wider = study.space, studies[f"biofilm-inflow{end}"].space
        certain[rule] = true_posterior(table, likelihood, space, rate=rate, nodes=plan.nodes)
        fields = true_fields(table, likelihood, nodes=plan.nodes)
        joint[rule] = true_posterior(table, likelihood, wider, nodes=plan.nodes, fields=fields)
        cut[rule] = true_posterior(table, likelihood, wider, nodes=plan.nodes, fields=fields, reading="cut")
    return Truths(table, errors, certain, joint, cut)


def _between(table: FieldTable, number: int) -> Float[np.ndarray, "run 3"]:
    """Return random points all over the table, none of them a node."""
    return np.asarray(table.coordinates.from_box(np.random.default_rng(0).uniform(-0.99, 1.0, (number, 3))))


def _likelihood(outcome: Outcome) -> InterfaceLikelihood:
    problem = outcome.calibration.problem
    return InterfaceLikelihood(problem.observations, problem.measure)


def _design(outcome: Outcome) -> NestedDesign:
    """Return the whole design with its log-likelihoods, NaN if a run failed."""
    calibration = outcome.calibration
    names = calibration.problem.space.names
    x = np.array([[record.inputs[name] for name in names] for record in calibration.records])
    values = np.full(len(x), np.nan)
    values[[record.ok for record in calibration.records]] = next(iter(calibration.log_likelihoods.values()))
    return NestedDesign(x, values)


def _larger(study: Study, truths: Truths, rule: str, plan: Plan) -> tuple[LargerDesign, ...]:
    truth: dict[Reading, GridPosterior] = {
        "joint": truths.joint[rule].posterior,
        "cut": truths.cut[rule].posterior,
    }
    return larger_designs(truths.joint[rule].field, truth, study.space, sizes=plan.larger)


def _convergence(
    studies: Mapping[str, Study],
    outcomes: Mapping[str, Outcome],
    results: Path,
    plan: Plan,
    executor: Executor | None,
    observer: Observer,
    made: _Runs,
) -> dict[str, Convergence]:
    """Extend the design of S6 to the largest training size plus test points, and fit a surrogate for each size."""
    study = studies["biofilm-parts"]
    space, model = study.space, study.model
    largest = max(plan.sizes)
    design = space.to_physical(sobol(_with_spare(largest) + plan.tests, space.dim, scramble=study.settings.scramble))
    inputs = [{**study.fixed, **space.as_mapping(x)} for x in design]
    with Ledger.open(results / "parts.sqlite", model=model, description="training size, S6") as ledger:
        ledger.copy_from(study.ledger_path, [run_key(fingerprint(model), entry) for entry in inputs])
        made.count(ledger, model, inputs)
        records = run_campaign(
            model, inputs, ledger=ledger, executor=executor or study.executor, on_record=observer.run
        )
    ok = np.array([record.ok for record in records])
    found = {}
    for rule, end in RULES.items():
        outcome = outcomes[f"biofilm-parts{end}"]
        likelihood = _likelihood(outcome)
        values = np.array([likelihood(record.interfaces) for record in records if record.ok])
        test = np.flatnonzero(ok) >= len(design) - plan.tests
        x = design[ok]
        found[rule] = convergence_study(
            x[~test], values[~test], x[test], values[test], sizes=plan.sizes,
            kernel=outcome.calibration.settings.kernel,
        )  # fmt: skip
    return found


def _with_spare(runs: int) -> int:
    """Return how many runs to make so that `runs` succeed if one in ten fails."""
    return -(-runs * 10 // 9)
