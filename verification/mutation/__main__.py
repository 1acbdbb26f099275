"""How many small mistakes in the code that a posterior is trusted for would the tests notice?

Each mutant is the package with one change, see `operators`. The tests that execute its line run, see `covering`, until
one fails: those of its own room and of rooms that use it; with ``--far`` those of all rooms. Mutants that survive must
be explained in `explained.csv`, or a test is missing. Files are named from the package's folder, ``--share k/n`` takes
every nth mutant, from the kth on, and ``--seconds`` are those of tests for each mutant.
Results are kept and not repeated for the same mutant, until the text of its file changes; ``--again`` repeats those
that survived unexplained, with tests as they are now; ``--confirm`` tries the tests that noticed mutants without a
change, so that those that fail then do not count; and ``--record`` writes all results into `recorded.csv`.

    python -m verification.mutation [--number 1000] [--seed 1] [--share 1/2] [--seconds 60] [--again] [--far] [FILE ...]
    python -m verification.mutation --confirm
    python -m verification.mutation --record
"""

import json
import os
import shutil
import sys
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from verification.mutation import results
from verification.mutation.covering import Covering, measured
from verification.mutation.operators import Mutant
from verification.mutation.places import TIERS, drawn, near, part_of
from verification.mutation.results import PACKAGE
from verification.mutation.trial import Outcome, prepare, tried
from verification.validation.tables import ROOT, arguments

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


def unsteady(known: Sequence[results.Result], scratch: Path) -> set[str]:
    """Return those tests said to have noticed a mutant that also fail without one when only such tests run."""
    tests = {one["test"].partition("[")[0] for one in known if one["end"] == "failed"}
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


def confirm(known: Sequence[results.Result], kept: Path) -> None:
    """Note which mutants are unsure, because the test that noticed them fails without a change too."""
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(PACKAGE, Path(folder) / "strandline")
        doubtful = unsteady(known, Path(folder))
    with kept.open("a", encoding="utf-8") as file:
        for one in known:
            if one["end"] == "failed" and one["test"].partition("[")[0] in doubtful:
                file.write(json.dumps({**one, "end": "unsure"}, ensure_ascii=False) + "\n")


def main() -> None:
    """Run the command."""
    flags = dict.fromkeys(("again", "far", "confirm", "record"), False)
    asked = arguments(__doc__, words="FILE", number=1000, seed=1, share="1/1", seconds=60.0, **flags)
    part, parts = map(int, asked.share.split("/"))
    OUTPUT.mkdir(exist_ok=True)
    kept = OUTPUT / "mutants.jsonl"
    known = results.known_results(PACKAGE, RECORDED, kept)
    if asked.record:
        results.record(known.values(), RECORDED)
        print(results.table(list(known.values())).markdown())
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
            if asked.words and str(path) not in asked.words:
                continue
            row = {"file": str(path), "text": results.fingerprint(PACKAGE / path), **mutant.texts()}
            name = results.name_of(row)
            survived = known.get(name, {}).get("end") in results.SURVIVED
            if name not in known or (asked.again and survived and not results.explained(row)):
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
    print(results.table(rows).markdown())


if __name__ == "__main__":
    main()
