"""Which tests execute which lines, so that a mutant need not run all others.

Every file of tests runs on its own, with coverage.py. JAX traces a function once in a process, so that coverage.py does
not see a second test execute it. So the tests seen to execute a line come first, then the others in their files. Those
of the changed file itself come before others, quick ones before slow ones, and only as many as run in a given time: a
mutant that they do not notice counts as one that survived.
"""

import json
import os
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import coverage
import pytest
from filelock import FileLock
from verification.mutation.results import fingerprint
from verification.mutation.trial import forked, run_tests

LINES = 6
"""Most lines of an expression: Python may count the later ones to the first."""


@dataclass(frozen=True)
class Covering:
    """Tests that execute lines, by file of the package, line of it and file of tests; and seconds of each test.

    There are no names where only the fixtures of a file execute a line. Seconds are with coverage.
    """

    tests: Mapping[str, Mapping[int, Mapping[str, Sequence[str]]]]
    seconds: Mapping[str, Mapping[str, float]]

    def stages(self, file: str, line: int, most: float) -> list[list[str]]:
        """Return tests for a change of a line, in the order in which to try them: first those that execute it.

        Tests in the file named after the changed one are among them: what processes that they start execute is not
        seen. Together they may take `most` seconds, without their start; one test may take more.
        """
        lines = self.tests.get(file, {})
        found = next((lines[one] for one in range(line, line - LINES, -1) if one in lines), {})
        own = {one for one in self.seconds if Path(one).stem == f"test_{Path(file).stem}"}
        order = sorted({*found, *own}, key=lambda one: (not _own(file, one), sum(self.seconds[one].values())))
        quick = [(one, name) for one in order for name in sorted(self.seconds[one], key=self.seconds[one].__getitem__)]
        seen = [(one, name) for one, name in quick if name in found.get(one, ())]
        unseen = [(one, name) for one, name in quick if name not in found.get(one, ())]
        stages: list[list[str]] = [[], []]
        left, any_yet = 0.0, False
        for stage, some in zip(stages, (seen, unseen), strict=True):
            left += 0.5 * most
            for one, name in some:
                needed = self.seconds[one][name]
                if needed < left or not any_yet:
                    stage.append(f"{one}::{name}")
                    left, any_yet = left - needed, True
        return [stage for stage in stages if stage]

    def limit(self, stage: Sequence[str]) -> float:
        """Return the seconds after which tests of a stage hang."""
        parts = [one.partition("::") for one in stage]
        return 40.0 + 4.0 * sum(self.seconds[one].get(name, 0.0) for one, _, name in parts)


def _own(file: str, tests: str) -> bool:
    """Return whether a file of tests is named after a file of the package."""
    return Path(file).stem in Path(tests).stem


def measured(package: Path, files: Sequence[Path], kept: Path) -> Covering:
    """Return which tests in these files execute which lines of a package.

    What is kept, one file for each file of tests, is not measured again until the text of that file changes. After
    changes of the package, remove it.
    """
    tests: dict[str, dict[int, dict[str, Sequence[str]]]] = {}
    seconds: dict[str, Mapping[str, float]] = {}
    half = os.getpid() % 2  # two processes begin with different files
    for file in (*files[half::2], *files[1 - half :: 2]):
        place, text = kept / (str(file).replace("/", "-") + ".json"), fingerprint(file)
        with FileLock(f"{place}.lock"):
            found = json.loads(place.read_text("utf-8")) if place.exists() else {}
            if found.get("text") != text:
                found = {"text": text, **_measure(package, file, kept)}
                place.write_text(json.dumps(found), "utf-8")
        seconds[str(file)] = found["seconds"]
        for name, lines in found["lines"].items():
            for line, functions in lines.items():
                tests.setdefault(name, {}).setdefault(int(line), {})[str(file)] = functions
    return Covering(tests, seconds)


class _Clock:
    """Plugin of pytest that adds up the seconds of each test."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_logreport(self, report: pytest.TestReport) -> Iterator[None]:
        self.seconds[report.location[2].partition("[")[0]] += report.duration
        return (yield)


def _measure(package: Path, file: Path, kept: Path) -> dict[str, object]:
    data, times = kept / f"coverage-{os.getpid()}", kept / f"seconds-{os.getpid()}.json"
    data.unlink(missing_ok=True)

    def unwatched() -> int:
        clock = _Clock()
        code = run_tests([str(file)], [clock])
        times.write_text(json.dumps(clock.seconds), "utf-8")
        return code

    def watched() -> int:
        cover = coverage.Coverage(data_file=data, source=[str(package)], config_file=False)
        cover.set_option("run:dynamic_context", "test_function")
        with cover.collect():
            code = unwatched()
        cover.save()
        return code

    output = kept / f"output-{os.getpid()}.txt"
    if forked(watched, output, 3600.0).end != "passed":  # some tests and coverage.py get in each other's way
        outcome = forked(unwatched, output, 3600.0)
        if outcome.end != "passed":
            raise RuntimeError(f"tests in {file} do not pass without a change: {outcome}")
        return {"seconds": json.loads(times.read_text("utf-8")), "lines": {}}
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
    return {"seconds": json.loads(times.read_text("utf-8")), "lines": lines}
