"""Mutants of a small package: noticed, not noticed, endless, broken."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from verification.mutation.covering import Covering
from verification.mutation.places import PARTS, drawn

ROOT = Path(__file__).parents[4]
PROGRAM = """
import json, sys
from pathlib import Path
from verification.mutation.trial import tried

scratch, tests, limit = Path(sys.argv[1]), sys.argv[2], float(sys.argv[3])
found = tried(scratch, [tests], scratch / "output.txt", limit)
print(json.dumps([found.end, found.test]))
"""
RIGHT = "def half(x):\n    return x / 2\n"


def judged(folder: Path, source: str, test: str, limit: float = 60.0) -> tuple[str, str]:
    (folder / "strandline").mkdir()
    (folder / "strandline" / "__init__.py").write_text(source, "utf-8")
    (folder / "test_it.py").write_text(f"from strandline import half\n\ndef test_half():\n    {test}\n", "utf-8")
    command = [sys.executable, "-c", PROGRAM, str(folder), str(folder / "test_it.py"), str(limit)]
    done = subprocess.run(
        command, cwd=folder, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=True
    )
    end, name = json.loads(done.stdout.splitlines()[-1])
    return end, name


@pytest.mark.parametrize(
    ("source", "test", "limit", "end"),
    [
        (RIGHT, "assert half(3) == 1.5", 60.0, "passed"),
        (RIGHT.replace("/", "*"), "assert half(3) == 1.5", 60.0, "failed"),
        (RIGHT.replace("/", "*"), "assert half(0) == 0", 60.0, "passed"),
        ("raise ImportError", "pass", 60.0, "broke"),
        ("def half(x):\n    while True: pass\n", "half(1)", 4.0, "hung"),
    ],
    ids=["right", "noticed", "not noticed", "broken", "endless"],
)
def test_a_small_package(tmp_path: Path, source: str, test: str, limit: float, end: str) -> None:
    found, name = judged(tmp_path, source, test, limit)
    assert found == end
    assert name.endswith("test_it.py::test_half") == (end == "failed")


def test_every_file_is_drawn_and_the_seed_decides_the_rest() -> None:
    package = ROOT / "src" / "strandline"
    one, same, other = drawn(package, 200, 1), drawn(package, 200, 1), drawn(package, 200, 2)
    assert len(one) == 200
    assert one == same != other
    files = {file for file, _ in one}
    assert {str(file.parent) for file in files} == {folder for part in PARTS.values() for folder in part}
    assert len(files) > 80


def test_what_is_drawn_of_a_file_does_not_depend_on_the_others(tmp_path: Path) -> None:
    package = ROOT / "src" / "strandline"
    for folder in (folder for part in PARTS.values() for folder in part):
        (tmp_path / folder).mkdir(parents=True)
        for file in (package / folder).glob("*.py"):
            (tmp_path / folder / file.name).write_text(file.read_text("utf-8"), "utf-8")
    changed = tmp_path / "smc" / "moves.py"
    changed.write_text("def half(x: float) -> float:\n    return x / 2 + 1 - 1\n", "utf-8")
    before, after = (set(drawn(folder, 200, 1)) for folder in (package, tmp_path))
    kept = {one for one in before if one[0] != Path("smc/moves.py")}
    assert len(kept - after) <= 3  # a few more or fewer of each, for the same number in all


TESTS = {"smc/moves.py": {3: {"slow.py": ["test_a", "test_b"], "test_moves.py": []}, 40: {"slow.py": ["test_a"]}}}
SECONDS = {"slow.py": {"test_a": 9.0, "test_b": 9.0, "test_c": 2.0}, "test_moves.py": {"test_d": 90.0, "test_e": 1.0}}
COVERING = Covering(TESTS, SECONDS)


def test_tests_that_execute_a_line_come_first_and_of_others_those_named_like_the_file() -> None:
    assert COVERING.stages("smc/moves.py", 3, 1000.0) == [
        ["slow.py::test_a", "slow.py::test_b"],
        ["test_moves.py::test_e", "test_moves.py::test_d", "slow.py::test_c"],
    ]
    assert COVERING.stages("smc/moves.py", 40, 1000.0) == [
        ["slow.py::test_a"],
        ["test_moves.py::test_e", "test_moves.py::test_d", "slow.py::test_c", "slow.py::test_b"],
    ]
    assert COVERING.stages("smc/moves.py", 30, 9.0) == [["test_moves.py::test_e"]]


def test_only_tests_run_that_take_no_longer_than_asked() -> None:
    assert COVERING.stages("smc/moves.py", 3, 12.0) == [["slow.py::test_a"], ["test_moves.py::test_e"]]
    assert COVERING.stages("smc/moves.py", 40, 1.0) == [["slow.py::test_a"]]


def test_half_the_time_is_kept_for_tests_that_were_not_seen_to_execute_it() -> None:
    assert COVERING.stages("smc/moves.py", 3, 30.0) == [
        ["slow.py::test_a"],
        ["test_moves.py::test_e", "slow.py::test_c"],
    ]


def test_later_lines_of_an_expression_count_to_its_first() -> None:
    assert COVERING.stages("smc/moves.py", 42, 1.0) == [["slow.py::test_a"]]
    assert COVERING.stages("other.py", 3, 1.0) == []


def test_slow_tests_hang_later() -> None:
    quick, slow = (COVERING.limit([name]) for name in ("test_moves.py::test_e", "test_moves.py::test_d"))
    assert quick > 30.0
    assert slow > quick + 90.0
