"""What became of mutants: kept while they are tried, recorded in the repository, forgotten when their file changes."""

import csv
import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path

from verification.mutation.places import PARTS, part_of
from verification.validation import tables

PACKAGE = tables.ROOT / "src" / "strandline"
EXPLAINED = Path(__file__).parent / "explained.csv"
"""Changes that no test has to notice, and why; some only on lines with a certain text."""
COLUMNS = "file", "text", "line", "start", "before", "after", "end", "test"
SURVIVED = "passed", "unsure"
"""Ends of mutants that no test noticed, or only tests that fail without a change too."""
Result = Mapping[str, str]
"""Values of the columns, as texts."""


def fingerprint(file: Path) -> str:
    """Return a short hash of a file's text."""
    return hashlib.sha256(file.read_bytes()).hexdigest()[:12]


def name_of(result: Result) -> tuple[str, ...]:
    """Return what tells mutants apart."""
    return tuple(result[one] for one in ("file", "start", "before", "after"))


def known_results(package: Path, recorded: Path, kept: Path) -> dict[tuple[str, ...], Result]:
    """Return the results for the files of a package as they are now; later ones replace earlier ones.

    They come from the table in the repository and from what this machine has kept, one a line.
    """
    rows: list[Result] = []
    if recorded.exists():
        with recorded.open(encoding="utf-8", newline="") as file:
            rows += csv.DictReader(file)
    if kept.exists():
        rows += [json.loads(line) for line in kept.read_text("utf-8").splitlines()]
    texts = {one: fingerprint(package / one) for one in {row["file"] for row in rows} if (package / one).exists()}
    return {name_of(row): row for row in rows if texts.get(row["file"]) == row["text"]}


def explained(result: Result) -> bool:
    """Return whether explained.csv says why no test has to notice a mutant: this change, on such a line of its file."""
    file = result["file"]
    line = (PACKAGE / file).read_text("utf-8").splitlines()[int(result["line"]) - 1]
    change = file, result["before"], result["after"]
    return any((one["file"], one["before"], one["after"]) == change and one["on_line"] in line for one in _explained())


@cache
def _explained() -> list[Result]:
    with EXPLAINED.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def record(results: Iterable[Result], recorded: Path) -> None:
    """Write results into the table of the repository."""
    rows = sorted(results, key=lambda one: (one["file"], int(one["start"]), one["before"], one["after"]))
    with recorded.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def table(rows: Sequence[Result]) -> tables.Table:
    """Return how many mutants of each part were noticed."""

    def row(name: str, some: Sequence[Result]) -> tuple[str, int, int, int, int]:
        survived = [one for one in some if one["end"] in SURVIVED]
        number = sum(map(explained, survived))
        return name, len(some), len(some) - len(survived), number, len(survived) - number

    lines = [row(name, [one for one in rows if part_of(Path(one["file"])) == name]) for name in PARTS]
    heading = "part | mutants {d} | noticed {d} | explained {d} | neither {d}"
    return tables.table("mutants", "Mutants", heading, [*lines, row("all", rows)])
