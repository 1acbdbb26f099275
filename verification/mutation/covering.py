"""Which tests execute which lines, so that a mutant need not run all others.

Every file of tests runs on its own, with coverage.py. JAX traces a function once in a process, so that coverage.py does
not see a second test execute it. So the tests seen to execute a line come first, then the others in quick files.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import coverage
from verification.mutation.trial import Outcome, forked, run_tests

__all__ = ["QUICK", "Covering", "measured"]

QUICK = 30.0
"""Seconds of a quick file of tests."""


@dataclass(frozen=True)
class Covering:
    """Tests that execute lines.

    Args:
        tests: Names by file of the package and line of it: those of the tests in each file of tests that execute
            it; none if only its fixtures do.
        seconds: Seconds that each file of tests takes, with coverage.
    """

    tests: Mapping[str, Mapping[int, Mapping[str, Sequence[str]]]]
    seconds: Mapping[str, float]

    def stages(self, file: str, line: int) -> list[list[str]]:
        """Return tests for a change of a line, in the order in which to try them: first those that execute it."""
        found = self.tests.get(file, {}).get(line, {})
        order = sorted(found, key=lambda one: self.seconds[one])
        named = [f"{one}::{name}" for one in order for name in found[one]]
        quick = [one for one in order if self.seconds[one] < QUICK]
        whole = [[one, *(f"--deselect={one}::{name}" for name in found[one])] for one in quick]
        return [*([named] if named else []), *whole]


def measured(package: Path, files: Sequence[Path], kept: Path) -> Covering:
    """Return which tests in these files execute which lines of a package; what is kept is not measured again.

    Args:
        package: Folder of the package.
        files: Files of tests.
        kept: Folder for what is measured: one file for each file of tests.
    """
    tests: dict[str, dict[int, dict[str, Sequence[str]]]] = {}
    seconds = {}
    for file in files:
        place = kept / (str(file).replace("/", "-") + ".json")
        if not place.exists():
            place.write_text(json.dumps(_measure(package, file, kept)), "utf-8")
        found = json.loads(place.read_text("utf-8"))
        seconds[str(file)] = found["seconds"]
        for name, lines in found["lines"].items():
            for line, functions in lines.items():
                tests.setdefault(name, {}).setdefault(int(line), {})[str(file)] = functions
    return Covering(tests, seconds)


def _measure(package: Path, file: Path, kept: Path) -> dict[str, object]:
    data = kept / "coverage"
    data.unlink(missing_ok=True)

    def run() -> int:
        watched = coverage.Coverage(data_file=data, source=[str(package)], config_file=False)
        watched.set_option("run:dynamic_context", "test_function")
        watched.start()
        code = run_tests([str(file)])
        watched.stop()
        watched.save()
        return code

    outcome: Outcome = forked(run, kept / "output.txt", 3600.0)
    if outcome.end != "passed":
        raise RuntimeError(f"tests in {file} do not pass without a change: {outcome}")
    read = coverage.CoverageData(str(data))
    read.read()
    lines: dict[str, dict[int, list[str]]] = {}
    for one in read.measured_files():
        by_line = read.contexts_by_lineno(one)
        lines[str(Path(one).relative_to(package))] = {
            line: sorted({name.rpartition(".")[2] for name in names if ".test_" in name})
            for line, names in by_line.items()
            if names
        }
    return {"seconds": outcome.seconds, "lines": lines}
