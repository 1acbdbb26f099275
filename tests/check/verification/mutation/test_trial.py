"""Which mutants are drawn, which tests are tried on them, and what becomes of those of a small package."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from verification.mutation.covering import Covering
from verification.mutation.places import PARTS, drawn, near, part_of

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
WRONG = RIGHT.replace("/", "*")


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
        (WRONG, "assert half(3) == 1.5", 60.0, "failed"),
        (WRONG, "assert half(0) == 0", 60.0, "passed"),
        ("raise ImportError", "pass", 60.0, "broke"),
        ("def half(x):\n    while True: pass\n", "half(1)", 2.0, "hung"),
    ],
    ids=["noticed", "not noticed", "broken", "endless"],
)
def test_a_small_package(tmp_path: Path, source: str, test: str, limit: float, end: str) -> None:
    found, name = judged(tmp_path, source, test, limit)
    assert found == end
    assert name.endswith("test_it.py::test_half") == (end == "failed")


def package_with(folder: Path, **of_moves: str) -> Path:
    """Write a file into a room of each part, one of them deeper; return the folder."""
    body = "".join(f"def f{k}(x: float) -> float:\n    return x / {k} - 1 if x < {k} else x + 1\n" for k in range(2, 9))
    files = [*(f"{folders[0]}/one.py" for folders in PARTS.values()), "runs/deep/two.py", "report/page.py"]
    for file in files:
        path = folder / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(of_moves.get(path.parent.name, body), "utf-8")
    return folder


def test_every_file_of_a_part_is_drawn_and_the_seed_decides_the_rest(tmp_path: Path) -> None:
    package = package_with(tmp_path)
    one, same, other = drawn(package, 40, 1), drawn(package, 40, 1), drawn(package, 40, 2)
    assert len(one) == 40
    assert one == same != other
    assert {part_of(file) for file, _ in one} == set(PARTS)
    files = {str(file) for file, _ in one}
    assert "runs/deep/two.py" in files
    assert "report/page.py" not in files
    assert len(files) == len(PARTS) + 1


def test_what_is_drawn_of_a_file_does_not_depend_on_the_others(tmp_path: Path) -> None:
    changed = package_with(tmp_path / "changed", smc="def half(x: float) -> float:\n    return x / 2 + 1 - 1\n")
    before, after = (set(drawn(folder, 40, 1)) for folder in (package_with(tmp_path / "whole"), changed))
    kept = {one for one in before if part_of(one[0]) != "sampler"}
    assert len(kept - after) <= 3  # a few more or fewer of each, for the same number in all


def test_tests_near_a_part_are_those_of_its_rooms_quick_ones_first() -> None:
    assert part_of(Path("design/active/repulsion.py")) == "active design"
    rooms = ("calibration", "design")
    assert near("active design") == [f"{tier}/{room}" for tier in ("unit", "study", "doors") for room in rooms]


TESTS = {"smc/moves.py": {3: {"slow.py": ["test_a", "test_b"], "test_moves.py": []}, 40: {"slow.py": ["test_a"]}}}
SECONDS = {"slow.py": {"test_a": 9.0, "test_b": 9.0, "test_c": 2.0}, "test_moves.py": {"test_d": 90.0, "test_e": 1.0}}
COVERING = Covering(TESTS, SECONDS)
A, B, C = (f"slow.py::test_{name}" for name in "abc")
D, E = (f"test_moves.py::test_{name}" for name in "de")


@pytest.mark.parametrize(
    ("line", "seconds", "stages"),
    [
        (3, 1000.0, [[A, B], [E, D, C]]),  # those that execute it, then those named like the file
        (40, 1000.0, [[A], [E, D, C, B]]),
        (30, 9.0, [[E]]),
        (3, 12.0, [[A], [E]]),  # only those that take no longer than asked
        (3, 30.0, [[A], [E, C]]),  # half the time for those that were not seen to execute it
        (42, 1.0, [[A]]),  # later lines of an expression count to its first
    ],
)
def test_tests_of_a_line_come_first_and_fill_the_time(line: int, seconds: float, stages: list[list[str]]) -> None:
    assert COVERING.stages("smc/moves.py", line, seconds) == stages
    assert COVERING.stages("other.py", line, 1.0) == []


def test_slow_tests_hang_later() -> None:
    quick, slow = COVERING.limit([E]), COVERING.limit([D])
    assert quick > 30.0
    assert slow > quick + 90.0
