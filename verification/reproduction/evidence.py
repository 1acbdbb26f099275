"""The evidence for the claims: the studies, the true posteriors, the designs that grow."""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from verification.reproduction import designs
from verification.reproduction.field_table import FieldTable, tabulate, withheld
from verification.reproduction.grid_posterior import Reading
from verification.reproduction.truth import NODES, TruePosterior, true_fields, true_posteriors

from strandline.calibration import Observer
from strandline.design import sobol
from strandline.foundations import InvalidInput
from strandline.likelihood import InterfaceLikelihood
from strandline.models.identity import fingerprint
from strandline.runs import Executor, Ledger, run_campaign, run_key
from strandline.studies import Outcome, PosteriorCheck, Study, check_posterior, load_study, run_study

STUDIES = (
    "biofilm-uniform", "biofilm-uniform-refined", "biofilm-informed", "biofilm-measures", "biofilm-inflow",
    "biofilm-inflow-refined", "biofilm-parts", "biofilm-parts-refined", "biofilm-parts-iterated",
)  # fmt: skip
"""Study folders, in an order that has the runs ready that each reuses."""
NOT_CHECKED = ("biofilm-informed", "biofilm-measures")
RULES = {"centre": "", "refined": "-refined"}
"""Ends of the folder's names by quadrature of the currents."""


@dataclass(frozen=True)
class Plan:
    """The extent of the work in addition to the studies themselves.

    `table` and `nodes` are the intervals of the table of interfaces, even, and the nodes of the log-likelihood, in
    load, ν and V. `checks` runs measure the table's error; `nested`, `larger` and `sizes` are those of the designs of
    S2, of S5 and of Fig. 12, with `tests` later points of its sequence. Each check of a posterior has `draws`.
    """

    table: tuple[int, int, int] = (6, 10, 8)
    nodes: tuple[int, int, int] = NODES
    checks: int = 60
    nested: tuple[int, ...] = designs.NESTED
    larger: tuple[int, ...] = designs.LARGER
    sizes: tuple[int, ...] = designs.SEVEN_INPUTS
    tests: int = 100
    draws: int = 200


@dataclass(frozen=True, eq=False)
class Truths:
    """Posteriors of the true model with known inflow (S3) and, in each reading, with uncertain inflow (S5), by rule.

    They come from the table; `errors` are the largest distances of a point from its place there, mm, in further runs.
    """

    table: FieldTable
    errors: np.ndarray
    certain: Mapping[str, TruePosterior]
    uncertain: Mapping[str, Mapping[Reading, TruePosterior]]


@dataclass(frozen=True)
class Cost:
    """Forward runs made, forward runs found in ledgers, and seconds by stage, for one part of the work."""

    name: str
    made: int
    reused: int
    seconds: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Evidence:
    """The whole evidence: by study what it is, what it found and how its posterior fared with the true model.

    True posteriors, nested designs of S2, larger designs of S5 and the convergence of Fig. 12 are by quadrature rule.
    """

    studies: Mapping[str, Study]
    outcomes: Mapping[str, Outcome]
    checks: Mapping[str, PosteriorCheck]
    truths: Truths
    nested: Mapping[str, tuple[designs.NestedStep, ...]]
    larger: Mapping[str, tuple[designs.LargerDesign, ...]]
    convergence: Mapping[str, designs.Convergence]
    costs: tuple[Cost, ...]


@dataclass(frozen=True, eq=False)
class _Work:
    """The studies, and how and where further runs are made."""

    studies: Mapping[str, Study]
    outcomes: dict[str, Outcome]
    results: Path
    plan: Plan
    executor: Executor | None
    observer: Observer
    costs: list[Cost]

    @contextmanager
    def part(self, name: str) -> Iterator[dict[str, int]]:
        """Note the seconds of a part of the work, and the runs that it says it has made and reused."""
        self.observer.stage(name)
        begun, runs = time.perf_counter(), {"made": 0, "reused": 0}
        yield runs
        self.costs.append(Cost(name, runs["made"], runs["reused"], {"in all": time.perf_counter() - begun}))

    def likelihood(self, name: str) -> InterfaceLikelihood:
        problem = self.outcomes[name].calibration.problem
        return InterfaceLikelihood(problem.observations, problem.measure)


def gather(folder: Path, results: Path, *, plan: Plan, executor: Executor | None, observer: Observer) -> Evidence:
    """Run all studies and all comparisons; finished forward runs are not repeated.

    `folder` holds the folders of `STUDIES`, `results` will hold the ledgers of further runs.
    """
    studies = {name: load_study(folder / name) for name in STUDIES}
    work = _Work(studies, {}, results, plan, executor, observer, [])
    for name, study in studies.items():
        observer.stage(name)
        work.outcomes[name] = run_study(study, executor=executor, observer=observer)
        summary = work.outcomes[name].summary
        work.costs.append(Cost(name, summary["runs"]["new"], summary["runs"]["reused"], summary["seconds"]))
    checks = {}
    for name in (name for name in STUDIES if name not in NOT_CHECKED):
        observer.stage(f"{name}: check")
        checks[name] = check_posterior(studies[name], draws=plan.draws, executor=executor, observer=observer)
        content = checks[name].content
        runs, seconds = content["runs"], {"check": content["seconds"]}
        work.costs.append(Cost(f"{name}: check", runs["new"], runs["reused"], seconds))
    truths = _truths(work)
    grown = _nested(work, truths), _larger(work, truths), _convergence(work)
    return Evidence(studies, work.outcomes, checks, truths, *grown, tuple(work.costs))


def require_studies(folder: Path) -> None:
    """Refuse a folder that lacks some of `STUDIES`."""
    missing = [name for name in STUDIES if not (folder / name / "study.yaml").is_file()]
    if missing:
        value, remedy = f"{folder}, without {', '.join(missing)}", "Say where it is with --studies."
        expected = "the folder `studies` of the project"
        raise InvalidInput("folder of the studies to reproduce", value=value, expected=expected, remedy=remedy)


def _truths(work: _Work) -> Truths:
    """Tabulate interfaces, withhold random runs all over the table, and integrate the true posteriors."""
    study, plan = work.studies["biofilm-uniform"], work.plan
    model: Any = study.model
    with work.part("true posteriors") as runs:
        with Ledger.open(work.results / "table.sqlite", model=model, description="table of interfaces") as ledger:
            before, where = ledger.counts().total, {"ledger": ledger, "executor": work.executor or study.executor}
            table = tabulate(model, model.undeformed(), intervals=plan.table, **where)
            between = table.coordinates.from_box(np.random.default_rng(0).uniform(-0.99, 1.0, (plan.checks, 3)))
            errors = withheld(table, model, between, **where)
            runs["made"] = ledger.counts().total - before
            runs["reused"] = table.runs + plan.checks - runs["made"]
        certain, uncertain, rate = {}, {}, study.fixed["V_in"]
        for rule, end in RULES.items():
            likelihood, wider = work.likelihood(f"biofilm-uniform{end}"), work.studies[f"biofilm-inflow{end}"].space
            fields = true_fields(table, likelihood, nodes=plan.nodes, rate=rate)
            certain[rule] = true_posteriors(fields, study.space, rate=rate)["joint"]
            uncertain[rule] = true_posteriors(true_fields(table, likelihood, nodes=plan.nodes), wider)
    return Truths(table, errors, certain, uncertain)


def _nested(work: _Work, truths: Truths) -> dict[str, tuple[designs.NestedStep, ...]]:
    """Fit surrogates to the first runs of the design of S3, failed runs included."""
    space, found = work.studies["biofilm-uniform"].space, {}
    with work.part("nested designs"):
        for rule, end in RULES.items():
            calibration = work.outcomes[f"biofilm-uniform{end}"].calibration
            x = np.array([[record.inputs[name] for name in space.names] for record in calibration.records])
            values = np.full(len(x), np.nan)
            values[[record.ok for record in calibration.records]] = next(iter(calibration.log_likelihoods.values()))
            truth = truths.certain[rule].posterior
            found[rule] = designs.nested_surrogates(x, values, truth, space, sizes=work.plan.nested)
    return found


def _larger(work: _Work, truths: Truths) -> dict[str, tuple[designs.LargerDesign, ...]]:
    """Read the runs of large designs from the table."""
    found = {}
    with work.part("larger designs in three inputs"):
        for rule, end in RULES.items():
            field = truths.uncertain[rule]["joint"].field
            posteriors = {reading: one.posterior for reading, one in truths.uncertain[rule].items()}
            space = work.studies[f"biofilm-inflow{end}"].space
            found[rule] = designs.larger_designs(field, posteriors, space, sizes=work.plan.larger)
    return found


def _convergence(work: _Work) -> dict[str, designs.Convergence]:
    """Extend the design of S6 to the largest training size plus test points, and fit a surrogate for each size."""
    study, plan = work.studies["biofilm-parts"], work.plan
    space, model = study.space, study.model
    spare = -(-max(plan.sizes) * 10 // 9)  # one run in ten may fail
    design = space.to_physical(sobol(spare + plan.tests, space.dim, scramble=study.settings.scramble))
    inputs = [{**study.fixed, **space.as_mapping(x)} for x in design]
    keys = [run_key(fingerprint(model), entry) for entry in inputs]
    found = {}
    with work.part("training size in seven inputs") as runs:
        with Ledger.open(work.results / "parts.sqlite", model=model, description="training size, S6") as ledger:
            ledger.copy_from(study.ledger_path, keys)
            runs["reused"] = len(ledger.latest(set(keys)))
            runs["made"] = len(set(keys)) - runs["reused"]
            options = {"executor": work.executor or study.executor, "on_record": work.observer.run}
            records = run_campaign(model, inputs, ledger=ledger, **options)
        ok = np.array([record.ok for record in records])
        test = np.flatnonzero(ok) >= spare
        for rule, end in RULES.items():
            name = f"biofilm-parts{end}"
            likelihood, kernel = work.likelihood(name), work.outcomes[name].calibration.settings.kernel
            x, values = design[ok], np.array([likelihood(record.interfaces) for record in records if record.ok])
            training, tests = (x[~test], values[~test]), (x[test], values[test])
            found[rule] = designs.convergence_study(*training, *tests, sizes=plan.sizes, kernel=kernel)
    return found
