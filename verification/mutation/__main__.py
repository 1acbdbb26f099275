"""How many small mistakes in the code that a posterior is trusted for would the tests notice?

Each mutant is the package with one change, see `operators`. The tests that execute its line run, see `covering`, until
one fails: those of its own room and of rooms that use it; with ``--far`` those of all rooms. Mutants that survive must
be explained in `explained.csv`, or a test is missing.
Results are kept and not repeated for the same mutant, until the text of its file changes; ``--again`` repeats those
that survived unexplained, with tests as they are now; ``--confirm`` tries the tests that noticed mutants without a
change, so that those that fail then do not count; and ``--record`` writes all results into `recorded.csv`.

    python -m verification.mutation [--number 1000] [--seed 1] [--share 1/2] [--seconds 60] [--again] [--far] [FILE ...]
    python -m verification.mutation --confirm
    python -m verification.mutation --record
"""

import argparse
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from verification.mutation.covering import Covering, measured
from verification.mutation.operators import Mutant
from verification.mutation.places import TIERS, drawn, near, part_of
from verification.mutation.results import (
    SURVIVED,
    Result,
    explained,
    fingerprint,
    known_results,
    name_of,
    record,
    table,
)
from verification.mutation.trial import Outcome, prepare, tried

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "src" / "strandline"
OUTPUT = Path(__file__).parent / "output"
RECORDED = Path(__file__).parent / "recorded.csv"


@cache
def covering_of(part: str, far: bool) -> Covering:
    """Return which tests execute which lines, of those that should notice changes in a part."""
    folders = [ROOT / "tests" / folder for folder in (TIERS[:2] if far else near(part))]
    files = sorted({file.relative_to(ROOT) for folder in folders for file in folder.rglob("test_*.py")})
    (OUTPUT / "covering").mkdir(exist_ok=True)
    return measured(PACKAGE, files, OUTPUT / "covering")


def judged(file: Path, mutant: Mutant, covering: Covering, scratch: Path, most: float) -> Outcome:
    """Return what the tests make of a mutant of a file in so many seconds; `scratch` has a copy of the package."""
    place = scratch / "strandline" / file
    place.write_text(mutant.applied(place.read_text("utf-8")), "utf-8")
    try:
        total = 0.0
        for tests in covering.stages(str(file), mutant.line, most):
            found = tried(scratch, tests, scratch / "output.txt", covering.limit(tests))
            total += found.seconds
            if found.end != "passed":
                return Outcome(found.end, found.test, total)
        return Outcome("passed", "", total)
    finally:
        shutil.copy2(PACKAGE / file, place)


def unsteady(results: Sequence[Result], scratch: Path) -> set[str]:
    """Return those tests said to have noticed a mutant that also fail without one when only such tests run."""
    tests = {one["test"].partition("[")[0] for one in results if one["end"] == "failed"}
    found: set[str] = set()
    for file in sorted({one.partition("::")[0] for one in tests}):
        while left := sorted(one for one in tests - found if one.startswith(f"{file}::")):
            outcome = tried(scratch, left, scratch / "output.txt", 900.0)
            if outcome.end == "passed":
                break
            found |= {outcome.test.partition("[")[0]} & set(left) or set(left)
            print(f"{outcome.end} without a change: {outcome.test or file}", flush=True)
    print(f"{len(tests) - len(found)} of {len(tests)} tests that noticed mutants pass without a change")
    return found


def confirm(results: Sequence[Result], kept: Path) -> None:
    """Note which mutants are unsure, because the test that noticed them fails without a change too."""
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(PACKAGE, Path(folder) / "strandline")
        doubtful = unsteady(results, Path(folder))
    with kept.open("a", encoding="utf-8") as file:
        for one in results:
            if one["end"] == "failed" and one["test"].partition("[")[0] in doubtful:
                file.write(json.dumps({**one, "end": "unsure"}, ensure_ascii=False) + "\n")


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description="Mutants that tests notice.")
    parser.add_argument("files", nargs="*", help="only mutants of these files, from the package's folder")
    parser.add_argument("--number", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--share", default="1/1", help="k/n: only every nth mutant, from the kth on")
    parser.add_argument("--seconds", type=float, default=60.0, help="seconds of tests to try for each mutant")
    parser.add_argument("--again", action="store_true", help="try again what survived and is not explained")
    parser.add_argument("--far", action="store_true", help="try tests of folders that use the changed one, too")
    parser.add_argument("--confirm", action="store_true", help="only try tests that noticed mutants without any")
    parser.add_argument("--record", action="store_true", help="only write what is known into recorded.csv")
    asked = parser.parse_args()
    part, parts = map(int, asked.share.split("/"))
    OUTPUT.mkdir(exist_ok=True)
    kept = OUTPUT / "mutants.jsonl"
    known = known_results(PACKAGE, RECORDED, kept)
    if asked.record:
        record(known.values(), RECORDED)
        print(table(list(known.values())).markdown())
        return
    os.chdir(ROOT)
    prepare()
    if asked.confirm:
        confirm(list(known.values()), kept)
        return
    rows = []
    with tempfile.TemporaryDirectory() as folder, kept.open("a", encoding="utf-8") as file:
        scratch = Path(folder)
        shutil.copytree(PACKAGE, scratch / "strandline")
        sys.dont_write_bytecode, os.environ["PYTHONDONTWRITEBYTECODE"] = True, "1"
        for path, mutant in drawn(PACKAGE, asked.number, asked.seed)[part - 1 :: parts]:
            if asked.files and str(path) not in asked.files:
                continue
            row = {"file": str(path), "text": fingerprint(PACKAGE / path), **mutant.texts()}
            name = name_of(row)
            if name not in known or (asked.again and known[name]["end"] in SURVIVED and not explained(row)):
                covering = covering_of(part_of(path), asked.far)
                found = judged(path, mutant, covering, scratch, asked.seconds)
                known[name] = {**row, "end": found.end, "test": found.test, "seconds": f"{found.seconds:.0f}"}
                file.write(json.dumps(known[name], ensure_ascii=False) + "\n")
                file.flush()
                print(
                    f"{found.end:7} {found.seconds:4.0f} s {path}:{mutant.line} {mutant.before} -> {mutant.after}",
                    flush=True,
                )
            rows.append(known[name])
    print(table(rows).markdown())


if __name__ == "__main__":
    main()
