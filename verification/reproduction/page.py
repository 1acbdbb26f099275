"""reproduction/report.html and claims.json."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from verification.reproduction.evidence import Evidence
from verification.reproduction.judgement import Claim
from verification.reproduction.pictures import Picture
from verification.reproduction.tables import (
    Table,
    against_truth,
    as_json,
    checks,
    cost,
    larger,
    sensitivities,
    uncertain_against_truth,
)

from strandline import __version__
from strandline.report import template
from strandline.studies.folder import whole_file, write_json

__all__ = ["write_claims", "write_page"]


WORDS = {"map": "MAP", "mean": "mean"}
"""Names on the page for the keys of a claim's numbers."""


@dataclass(frozen=True)
class Section:
    """One example of the study: titles, tables, pictures, claims."""

    key: str
    short: str
    title: str
    tables: tuple[Table, ...]
    figures: tuple[Picture, ...]
    claims: tuple[str, ...]


def _place(picture: Picture) -> tuple[int, str, str]:
    """Return a sort key for pictures in the study's order: number, letter, the figure itself before its variants."""
    number, _, variant = picture.number.partition(",")
    digits = number.rstrip("abcd")
    return int(digits), number[len(digits) :], variant


def sections(evidence: Evidence, pictures: Mapping[str, Picture]) -> tuple[Section, ...]:
    """Return the sections of the page in the study's order."""

    def shown(*numbers: str) -> tuple[Picture, ...]:
        chosen = (p for n, p in pictures.items() if n.split(",")[0].rstrip("abcd") in numbers or n in numbers)
        return tuple(sorted(chosen, key=_place))

    indices = {name: sensitivities(evidence, [name]) for name in ("biofilm-inflow", "biofilm-parts")}
    inflow, parts = (() if table is None else (table,) for table in indices.values())
    by_parts = [name for name in evidence.checks if name.startswith("biofilm-parts")]
    others = [name for name in evidence.checks if name not in by_parts]
    return (
        Section("S1", "S1 measures", "S1: three measures of discrepancy", (), shown("3", "4", "5", "6", "7"),
                ("C1", "C2", "C3")),
        Section("S2", "S2 training", "S2: size of the training set", (), shown("8"), ("C4",)),
        Section("S3", "S3 uniform", "S3: uniform prior", (against_truth(evidence),),
                shown("9a", "9a, refined", "9b"), ("C5", "C6")),
        Section("S4", "S4 informed", "S4: informed prior", (), shown("9c"), ("C7",)),
        Section("S5", "S5 inflow", "S5: uncertain inflow",
                (uncertain_against_truth(evidence), larger(evidence), checks(evidence, others), *inflow),
                shown("9d", "9d, cut", "10"), ("C8",)),
        Section("S6", "S6 parts", "S6: heterogeneous specimen", (checks(evidence, by_parts), *parts),
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


def write_page(
    evidence: Evidence, claims: Mapping[str, Claim], pictures: Sequence[Picture], folder: Path, seconds: float
) -> Path:
    """Write report.html into `folder`, whole or not at all, and return its path."""
    named = {picture.number: picture for picture in pictures}
    text = template("reproduction.html.j2", package="verification.reproduction").render(
        version=__version__,
        claims=claims,
        compared=compared,
        sections=sections(evidence, named),
        cost=cost(evidence.costs),
        seconds=seconds,
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
    content["truth"] = {
        "uniform": as_json(against_truth(evidence)),
        "uncertain_inflow": as_json(uncertain_against_truth(evidence)),
        "uncertain_inflow_with_more_runs": as_json(larger(evidence)),
    }
    content["cost"] = as_json(cost(evidence.costs)) | {"seconds": seconds}
    path = folder / "claims.json"
    write_json(path, content)
    return path
