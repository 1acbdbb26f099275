"""How many small mistakes in the code that a posterior is trusted for would the tests notice?

Each mutant is the package with one change, see `operators`. The tests that execute its line run, see `covering`, until
one fails. Mutants that survive must be explained in `explained`, or a test is missing. Results are kept in a file and
not repeated for the same mutant; ``--again`` repeats those that survived, with tests as they are now.

    python -m verification.mutation [--number 240] [--seed 1] [--share 1/2] [--again] [FILE ...]
"""

import argparse
import json
import os
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from verification.mutation.covering import Covering, measured
from verification.mutation.explained import EXPLAINED
from verification.mutation.operators import Mutant
from verification.mutation.places import PARTS, TESTS, drawn
from verification.mutation.trial import Outcome, prepare, tried
from verification.validation.tables import Table

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "src" / "strandline"
OUTPUT = Path(__file__).parent / "output"
LIMIT = 900.0
"""Most seconds of one call of pytest."""


def judged(file: Path, mutant: Mutant, covering: Covering, scratch: Path) -> Outcome:
    """Return what the tests make of a mutant."""
    place = scratch / "strandline" / file
    original = place.read_text("utf-8")
    place.write_text(mutant.applied(original), "utf-8")
    try:
        total = 0.0
        for tests in covering.stages(str(file), mutant.line):
            found = tried(scratch, tests, scratch / "output.txt", LIMIT)
            total += found.seconds
            if found.end != "passed":
                return Outcome(found.end, found.test, total)
        return Outcome("passed", "", total)
    finally:
        place.write_text(original, "utf-8")


def table(rows: Sequence[dict[str, str]]) -> Table:
    """Return how many mutants of each part were noticed."""

    def row(name: str, some: Sequence[dict[str, str]]) -> tuple[str, int, int, int, int]:
        survived = [one for one in some if one["end"] == "passed"]
        explained = sum((one["file"], one["before"], one["after"]) in EXPLAINED for one in survived)
        return name, len(some), len(some) - len(survived), explained, len(survived) - explained

    lines = [
        row(name, [one for one in rows if str(Path(one["file"]).parent) in folders]) for name, folders in PARTS.items()
    ]
    heads = "part", "mutants", "noticed", "explained", "neither"
    return Table("mutants", "Mutants", heads, ("s", "d", "d", "d", "d"), (*lines, row("all", rows)))


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description="Mutants that tests notice.")
    parser.add_argument("files", nargs="*", help="only mutants of these files, from the package's folder")
    parser.add_argument("--number", type=int, default=240)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--share", default="1/1", help="k/n: only every nth mutant, from the kth on")
    parser.add_argument("--again", action="store_true", help="try again what survived")
    asked = parser.parse_args()
    part, parts = map(int, asked.share.split("/"))
    kept = OUTPUT / f"mutants-{asked.seed}-{part}-{parts}.jsonl"
    OUTPUT.mkdir(exist_ok=True)
    known = {}
    if kept.exists():
        for line in kept.read_text("utf-8").splitlines():
            one = json.loads(line)
            known[one["file"], one["start"], one["before"], one["after"]] = one
    os.environ.setdefault("STRANDLINE_TEST_COMPILED", tempfile.mkdtemp(prefix="strandline-compiled-"))
    os.chdir(ROOT)
    prepare()
    files = sorted(file for folder in TESTS for file in (ROOT / "tests" / folder).rglob("test_*.py"))
    (OUTPUT / "covering").mkdir(exist_ok=True)
    covering = measured(PACKAGE, [file.relative_to(ROOT) for file in files], OUTPUT / "covering")
    rows = []
    with tempfile.TemporaryDirectory() as folder, kept.open("a", encoding="utf-8") as file:
        scratch = Path(folder)
        shutil.copytree(PACKAGE, scratch / "strandline", ignore=shutil.ignore_patterns("__pycache__"))
        for path, mutant in drawn(PACKAGE, asked.number, asked.seed)[part - 1 :: parts]:
            if asked.files and str(path) not in asked.files:
                continue
            name = str(path), mutant.start, mutant.before, mutant.after
            if name not in known or (asked.again and known[name]["end"] == "passed"):
                found = asdict(judged(path, mutant, covering, scratch))
                known[name] = {"file": str(path), **asdict(mutant), **found}
                file.write(json.dumps(known[name], ensure_ascii=False) + "\n")
                file.flush()
                print(f"{found['end']:7} {path}:{mutant.line} {mutant.before} -> {mutant.after}", flush=True)
            rows.append(known[name])
    print(table(rows).markdown())


if __name__ == "__main__":
    main()
