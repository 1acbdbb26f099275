"""reproduction/report.html and claims.json, and the tables in them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from verification.reproduction.designs import FITTED, MEAN_WITHIN, READINGS, SD_WITHIN, runs_to_find
from verification.reproduction.evidence import RULES, Cost, Evidence
from verification.reproduction.figures import Picture, draw
from verification.reproduction.judgement import Claim
from verification.reproduction.truth import TruePosterior

from strandline import __version__
from strandline.foundations import whole_file, write_json
from strandline.report import template

WORDS = {"map": "MAP", "mean": "mean"}
"""Names on the page for the keys of a claim's numbers."""
Cell = str | float | int | None


class Table(NamedTuple):
    """A table: names of its columns, rows of numbers and words, and a note below."""

    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str


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
        f"interpolated between them. At {len(errors)} further runs the median error of the table is "
        f"{1e3 * float(np.median(errors)):.2g} µm and the largest {1e3 * errors.max():.2g} µm; "
        f"a table of half the intervals moves a mean by at most {worst:.2g} sd.",
    )


def uncertain_against_truth(evidence: Evidence) -> Table:
    """Return the posterior of S5, joint and cut, from the sampler and from quadrature, against the true model."""
    truths = evidence.truths.uncertain
    rows: list[tuple[Cell, ...]] = []
    for rule, end in RULES.items():
        outcome = evidence.outcomes[f"biofilm-inflow{end}"]
        found = outcome.calibration.under_uncertainty
        assert found is not None
        of_cut = outcome.summary["under_uncertainty"]["cut"]["quadrature_check"]
        for name, reading, check, truth in (
            ("joint", found.joint, outcome.summary["quadrature_check"], truths[rule]["joint"]),
            ("cut", found.cut, of_cut, truths[rule]["cut"]),
        ):
            rows += _truth_rows(f"{name}, {rule}", reading.mean, reading.sd, truth)
            mean, sd = (np.array([check[key][figure] for key in ("E", "nu")]) for figure in ("mean", "sd"))
            rows += _truth_rows(f"{name}, {rule}, by quadrature", mean, sd, truth)
    halves = [truth for both in truths.values() for truth in both.values()]
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


class Section(NamedTuple):
    """One example of the study: title, tables, pictures, claims."""

    key: str
    title: str
    tables: tuple[Table, ...]
    figures: tuple[Picture, ...]
    claims: tuple[str, ...]


def sections(evidence: Evidence, pictures: Sequence[Picture]) -> tuple[Section, ...]:
    """Return the sections of the page in the study's order."""

    def shown(*names: str) -> tuple[Picture, ...]:
        """Return the figures of these numbers, with a letter or without, in their order, with all variants."""
        return tuple(one for name in names for one in pictures if one.number.partition(",")[0] == name)

    by_parts = [name for name in evidence.checks if name.startswith("biofilm-parts")]
    others = [name for name in evidence.checks if name not in by_parts]
    return (
        Section("S1", "S1: three measures of discrepancy", (), shown("3", "4", "5", "6", "7"), ("C1", "C2", "C3")),
        Section("S2", "S2: size of the training set", (), shown("8"), ("C4",)),
        Section("S3", "S3: uniform prior", (against_truth(evidence),), shown("9a", "9b"), ("C5", "C6")),
        Section("S4", "S4: informed prior", (), shown("9c"), ("C7",)),
        Section("S5", "S5: uncertain inflow",
                (uncertain_against_truth(evidence), larger(evidence), checks(evidence, others)),
                shown("9d", "10"), ("C8",)),
        Section("S6", "S6: heterogeneous specimen", (checks(evidence, by_parts),),
                shown("11", "12", "13", "14", "15"), ("C9", "C10")),
    )  # fmt: skip


def compared(claim: Claim) -> list[tuple[str, float, float]]:
    """Return the numbers that the study prints too: name, our number, the study's."""
    pairs = {key: (claim.numbers[key], theirs) for key, theirs in claim.study.items() if key in claim.numbers}
    return [
        (f"{WORDS.get(key, key)}: {name}", ours[name], theirs[name])
        for key, (ours, theirs) in pairs.items()
        if isinstance(theirs, Mapping) and isinstance(ours, Mapping)
        for name in theirs
        if name in ours
    ]


def write_page(evidence: Evidence, claims: Mapping[str, Claim], folder: Path) -> Path:
    """Write report.html into `folder`, whole or not at all, and return its path."""
    text = template("reproduction.html.j2", package="verification.reproduction").render(
        version=__version__,
        claims=claims,
        compared=compared,
        sections=sections(evidence, tuple(draw(evidence))),
        cost=cost(evidence.costs),
    )
    path = folder / "report.html"
    with whole_file(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8")
    return path


def write_claims(evidence: Evidence, claims: Mapping[str, Claim], folder: Path, seconds: float) -> Path:
    """Write claims.json: the claims by key, and under `studies` the summaries by study."""
    content: dict[str, Any] = {key: claim.as_json() for key, claim in claims.items()}
    content["studies"] = {name: outcome.summary for name, outcome in evidence.outcomes.items()}
    content["checks"] = {
        name: {k: v for k, v in check.content.items() if k not in ("particles", "interfaces")}
        for name, check in evidence.checks.items()
    }
    tables = against_truth(evidence), uncertain_against_truth(evidence), larger(evidence)
    names = "uniform", "uncertain_inflow", "uncertain_inflow_with_more_runs"
    content["truth"] = {name: table._asdict() for name, table in zip(names, tables, strict=True)}
    content["cost"] = cost(evidence.costs)._asdict() | {"seconds": seconds}
    path = folder / "claims.json"
    write_json(path, content)
    return path
