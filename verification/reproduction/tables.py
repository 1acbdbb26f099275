"""Tables of the page: posteriors compared with those of the true model, checks, sensitivities, runs and seconds."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from verification.reproduction.evidence import RULES, Cost, Evidence
from verification.reproduction.larger_designs import FITTED, MEAN_WITHIN, READINGS, SD_WITHIN, runs_to_find
from verification.reproduction.truth import TruePosterior

__all__ = ["Table", "against_truth", "as_json", "checks", "cost", "larger", "sensitivities", "uncertain_against_truth"]

Cell = str | float | int | None


@dataclass(frozen=True)
class Table:
    """A table: names of its columns, rows of numbers and words, and a note below."""

    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""


TRUTH_COLUMNS = ("posterior", "input", "mean", "true model", "off, sd", "sd", "true model", "ratio")
INPUTS = ("E [Pa]", "ν")


def against_truth(evidence: Evidence) -> Table:
    """Return the posterior of S3 from the sampler against the true model, by quadrature rule."""
    rows: list[tuple[Cell, ...]] = []
    for rule, end in RULES.items():
        posterior = evidence.outcomes[f"biofilm-uniform{end}"].calibration.posterior
        rows += _truth_rows(rule, posterior.mean, posterior.sd, evidence.truths.certain[rule])
    errors, truth = evidence.truths.errors, evidence.truths.certain
    worst = max(float(np.abs(t.from_half_table.mean).max()) for t in truth.values())
    return Table(
        TRUTH_COLUMNS,
        tuple(rows),
        f"The true model's posterior comes from a table of {evidence.truths.table.runs} forward runs, the interface "
        f"interpolated between them. At {len(errors.x)} further runs the median error of the table is "
        f"{1e3 * float(np.median(errors.distance)):.2g} µm and the largest {1e3 * errors.distance.max():.2g} µm; "
        f"a table of half the intervals moves a mean by at most {worst:.2g} sd.",
    )


def uncertain_against_truth(evidence: Evidence) -> Table:
    """Return the posterior of S5, joint and cut, from the sampler and from quadrature, against the true model."""
    rows: list[tuple[Cell, ...]] = []
    for rule, end in RULES.items():
        outcome = evidence.outcomes[f"biofilm-inflow{end}"]
        found = outcome.calibration.under_uncertainty
        assert found is not None
        of_cut = outcome.summary["under_uncertainty"]["cut"]["quadrature_check"]
        for name, reading, check, truth in (
            ("joint", found.joint, outcome.summary["quadrature_check"], evidence.truths.joint[rule]),
            ("cut", found.cut, of_cut, evidence.truths.cut[rule]),
        ):
            rows += _truth_rows(f"{name}, {rule}", reading.mean, reading.sd, truth)
            mean, sd = (np.array([check[key][figure] for key in ("E", "nu")]) for figure in ("mean", "sd"))
            rows += _truth_rows(f"{name}, {rule}, by quadrature", mean, sd, truth)
    halves = [t for group in (evidence.truths.joint, evidence.truths.cut) for t in group.values()]
    worst = max(float(np.abs(t.from_half_table.mean).max()) for t in halves)
    edge = max(t.posterior.edge_mass for t in halves)
    return Table(
        TRUTH_COLUMNS,
        tuple(rows),
        "The surrogate's posterior from the sampler's particles and, to check them, from quadrature, each against the "
        f"true model. A table of half the intervals moves a mean of the true model by at most {worst:.2g} sd. If the "
        f"likelihood beyond the soft end of the table were as it is at that end, {100 * edge:.2g} % of the mass would "
        "lie there.",
    )


def larger(evidence: Evidence) -> Table:
    """Return how far the surrogate of S5 is from the true model with more runs, and how many runs it needs."""
    rows: list[tuple[Cell, ...]] = []
    words = []
    for rule, designs in evidence.larger.items():
        for reading in READINGS:
            for design in designs:
                off = design.differences[reading]
                figures = (off.mean[0], 1 + off.sd_ratio[0], off.mean[1], 1 + off.sd_ratio[1])
                name = f"{reading}, {rule}" if design is designs[0] else ""
                found = "yes" if design.found(reading) else "no"
                rows.append((name, design.runs, *(float(v) for v in figures), found))
            runs = runs_to_find(designs, reading)
            words.append(f"{reading}, {rule}: " + (f"{runs}" if runs else f"more than {designs[-1].runs}"))
    return Table(
        ("posterior", "runs", "E: off, sd", "ratio of sd", "ν: off, sd", "ratio of sd", "found"),
        tuple(rows),
        f"The surrogate of S5 with more runs, by quadrature, against the true model; no forward run is made, the "
        f"log-likelihood of the design comes from the table, and hyperparameters from its first {FITTED} runs. Found: "
        f"means within {MEAN_WITHIN:g} sd and standard deviations within {100 * SD_WITHIN:g} %. Runs needed: "
        + "; ".join(words)
        + ".",
    )


def _truth_rows(
    name: str, mean: Float[np.ndarray, " dim"], sd: Float[np.ndarray, " dim"], truth: TruePosterior
) -> list[tuple[Cell, ...]]:
    """Return a row for each input: the posterior's figures and those of the true model."""
    exact = truth.posterior
    return [
        (name if k == 0 else "", label, float(mean[k]), float(exact.mean[k]),
         float((mean[k] - exact.mean[k]) / exact.sd[k]), float(sd[k]), float(exact.sd[k]), float(sd[k] / exact.sd[k]))
        for k, label in enumerate(INPUTS)
    ]  # fmt: skip


def checks(evidence: Evidence, names: Sequence[str]) -> Table:
    """Return the checks of posteriors with the true model."""
    rows: list[tuple[Cell, ...]] = []
    for name in names:
        content = evidence.checks[name].content
        shifts = {key: item["shift"] for key, item in content["inputs"].items()}
        worst = max(shifts, key=lambda key: abs(shifts[key]))
        true, surrogate = (float(np.median(content["particles"][k])) for k in ("true", "surrogate"))
        rows.append((name, content["draws"], content["runs"]["failed"], content["k_hat"], content["verdict"],
                     content["ess"], surrogate, true, f"{worst}: {shifts[worst]:+.2f}"))  # fmt: skip
    return Table(
        ("study", "draws", "failed", "k̂", "verdict", "effective draws", "median log L, surrogate", "true",
         "largest shift, sd"),
        tuple(rows),
        "k̂ is the shape of the Pareto distribution fitted to the largest importance weights: below 0.5 the reweighted "
        "moments can be trusted, above 0.7 nothing can. If nearly all draws are effective, the surrogate's posterior "
        "is the true one, and the tail that k̂ describes does not matter.",
    )  # fmt: skip


def sensitivities(evidence: Evidence, names: Sequence[str]) -> Table | None:
    """Return Sobol indices of the log-likelihood, first order and total; None if no study has them."""
    found = {name: evidence.outcomes[name].summary.get("sensitivity") for name in names}
    rows = tuple(
        (name, key, item["first"], item["total"])
        for name, indices in found.items()
        if indices is not None
        for key, item in indices["inputs"].items()
    )
    note = "Sobol indices of the surrogate of the log-likelihood under the prior: shares of its variance."
    return Table(("study", "input", "first order", "total"), rows, note) if rows else None


def cost(costs: Sequence[Cost]) -> Table:
    """Return the runs and seconds of each part of the work, and their sums."""
    stages = list(dict.fromkeys(stage for c in costs for stage in c.seconds))
    rows: list[tuple[Cell, ...]] = [
        (c.name, c.made, c.reused, sum(c.seconds.values()), *(c.seconds.get(stage) for stage in stages)) for c in costs
    ]
    total = sum(sum(c.seconds.values()) for c in costs)
    rows.append(("in all", sum(c.made for c in costs), sum(c.reused for c in costs), total, *(None for _ in stages)))
    return Table(
        ("part", "runs made", "runs found", "seconds", *stages),
        tuple(rows),
        f"{total / 60:.0f} minutes in all. A run found in a ledger is not made again.",
    )


def as_json(table: Table) -> dict[str, Any]:
    """Return a table as stored in claims.json."""
    return {"columns": list(table.columns), "rows": [list(row) for row in table.rows]}
