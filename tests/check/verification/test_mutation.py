"""What judges the tests: changes of the code that they should notice, which tests meet them, and the seconds of all."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest
from verification.mutation.covering import Covering
from verification.mutation.operators import mutants
from verification.mutation.places import PARTS, drawn, near, part_of
from verification.mutation.results import explained, fingerprint, known_results, name_of, record, table

ROOT = Path(__file__).parents[3]
SOURCE = '''
"""Text with β."""
SETTING = 0.05


def shift(α: "Float[np.ndarray, ' 3']", β: float = 2.0) -> float:
    """Return α - β."""
    if β < 0:
        raise ValueError(f"β is {β + 1}, not positive")
    if not α:
        return 0.0
    α = α - β
    return max(α / β, -SETTING)
'''
MADE = {
    ("α - β", "(α + β)"), ("α - β", "(β - α)"), ("α - β", "(α)"), ("α = α - β", "pass"), ("not α", "(False)"),
    ("not α", "(α)"), ("max(α / β, -SETTING)", "(min(α / β, -SETTING))"), ("-SETTING", "(SETTING)"),
    ("α / β", "(α * β)"), ("β < 0", "(β >= 0)"),
}  # fmt: skip


def changes(source):
    return {(one.before, one.after) for place in mutants(source) for one in place}


def test_mistakes_are_made_one_at_a_time_but_messages_settings_texts_and_axes_stay():
    found = changes(SOURCE)
    assert found >= MADE
    assert not {before for before, _ in found} & {"0.05", "2.0", "β + 1", "3"}
    assert ("β < 0", "(False)") not in found
    for text in ("'a' + name", "f'{a + b}'", "np.sum(x, axis=0)[1]"):
        of_text = changes(f"def f(a, b, x, name):\n    return {text}\n")
        assert not {before for before, _ in of_text} & {"'a' + name", "a + b", "0", "1"}
    for one in (one for place in mutants(SOURCE) for one in place):
        changed = one.applied(SOURCE)
        ast.parse(changed)
        before, after = SOURCE.encode(), changed.encode()
        assert changed != SOURCE
        assert after[: one.start] == before[: one.start]
        assert after.endswith(before[one.end :])
        assert before[: one.start].count(b"\n") + 1 == one.line


MOVES, STEPS = "smc/moves.py", "smc/deep/steps.py"


@pytest.fixture
def package(tmp_path):
    for name in (MOVES, STEPS):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("x = 1\ny = 1\n", "utf-8")
    return tmp_path


def result(package, file, start, end):
    texts = {"file": file, "text": fingerprint(package / file), "line": "1", "start": str(start)}
    return {**texts, "before": 'x, "β"', "after": "(x)", "end": end, "test": "", "seconds": "3"}


def test_what_is_recorded_is_read_again_until_the_text_of_its_file_changes(package):
    recorded, kept = package / "recorded.csv", package / "kept.jsonl"
    assert known_results(package, recorded, kept) == {}
    first, second = result(package, MOVES, 30, "passed"), result(package, MOVES, 4, "failed")
    record([first, second, result(package, STEPS, 4, "failed")], recorded)
    assert [row["start"] for row in known_results(package, recorded, kept).values()] == ["4", "4", "30"]
    kept.write_text(json.dumps({**first, "end": "failed"}) + "\n", "utf-8")
    found = known_results(package, recorded, kept)
    assert len(found) == 3
    assert found[name_of(first)]["end"] == "failed"
    (package / MOVES).write_text("x = 2\n", "utf-8")
    assert [row["file"] for row in known_results(package, recorded, kept).values()] == [STEPS]
    (package / STEPS).unlink()
    assert known_results(package, recorded, kept) == {}


def test_a_table_counts_what_was_noticed_in_rooms_within_rooms_too_and_an_explanation_holds_for_its_lines(package):
    ends = ["failed", "hung", "broke", "passed", "unsure"]
    rows = [result(package, STEPS if k < 3 else MOVES, k, end) for k, end in enumerate(ends)]
    found = {row[0]: row[1:] for row in table(rows).rows}
    assert found["sampler"] == found["all"] == (5, 3, 0, 2)
    assert found["posterior"] == (0, 0, 0, 0)
    known = {"anywhere": {(MOVES, "1", "(3)")}, "on_line": [(MOVES, "x = 1", "1", "(2)")]}
    for line, after, holds in (("1", "(2)", True), ("1", "(3)", True), ("2", "(2)", False), ("2", "(3)", True)):
        one = {"file": MOVES, "line": line, "before": "1", "after": after}
        assert explained(one, package=package, **known) == holds


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
def test_a_small_package(tmp_path, source, test, limit, end):
    (tmp_path / "strandline").mkdir()
    (tmp_path / "strandline" / "__init__.py").write_text(source, "utf-8")
    (tmp_path / "test_it.py").write_text(f"from strandline import half\n\ndef test_half():\n    {test}\n", "utf-8")
    command = [sys.executable, "-c", PROGRAM, str(tmp_path), str(tmp_path / "test_it.py"), str(limit)]
    options = {"cwd": tmp_path, "env": {"PYTHONPATH": str(ROOT)}, "capture_output": True, "text": True}
    found, name = json.loads(subprocess.run(command, **options, check=True).stdout.splitlines()[-1])
    assert found == end
    assert name.endswith("test_it.py::test_half") == (end == "failed")


def package_with(folder, **of_moves):
    """Write a file into a room of each part, one of them deeper; return the folder."""
    body = "".join(f"def f{k}(x: float) -> float:\n    return x / {k} - 1 if x < {k} else x + 1\n" for k in range(2, 9))
    files = [*(f"{folders[0]}/one.py" for folders in PARTS.values()), "runs/deep/two.py", "report/page.py"]
    for file in files:
        path = folder / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(of_moves.get(path.parent.name, body), "utf-8")
    return folder


def test_every_file_of_a_part_is_drawn_the_seed_decides_the_rest_and_not_the_other_files(tmp_path):
    package = package_with(tmp_path / "whole")
    one, same, other = drawn(package, 40, 1), drawn(package, 40, 1), drawn(package, 40, 2)
    assert len(one) == 40
    assert one == same != other
    assert {part_of(file) for file, _ in one} == set(PARTS)
    files = {str(file) for file, _ in one}
    assert "runs/deep/two.py" in files
    assert "report/page.py" not in files
    assert len(files) == len(PARTS) + 1
    changed = package_with(tmp_path / "changed", smc="def half(x: float) -> float:\n    return x / 2 + 1 - 1\n")
    kept = {place for place in one if part_of(place[0]) != "sampler"}
    assert len(kept - set(drawn(changed, 40, 1))) <= 3  # a few more or fewer of each, for the same number in all


TESTS = {"smc/moves.py": {3: {"slow.py": ["test_a", "test_b"], "test_moves.py": []}, 40: {"slow.py": ["test_a"]}}}
SECONDS = {"slow.py": {"test_a": 9.0, "test_b": 9.0, "test_c": 2.0}, "test_moves.py": {"test_d": 90.0, "test_e": 1.0}}
A, B, C = (f"slow.py::test_{name}" for name in "abc")
D, E = (f"test_moves.py::test_{name}" for name in "de")


def test_tests_of_a_line_come_first_and_fill_the_time_and_slow_ones_hang_later():
    covering = Covering(TESTS, SECONDS)
    for line, seconds, stages in (
        (3, 1000.0, [[A, B], [E, D, C]]),  # those that execute it, then those named like the file
        (40, 1000.0, [[A], [E, D, C, B]]),
        (30, 9.0, [[E]]),
        (3, 12.0, [[A], [E]]),  # only those that take no longer than asked
        (3, 30.0, [[A], [E, C]]),  # half the time for those that were not seen to execute it
        (42, 1.0, [[A]]),  # later lines of an expression count to its first
    ):
        assert covering.stages("smc/moves.py", line, seconds) == stages
        assert covering.stages("other.py", line, 1.0) == []
    quick, slow = covering.limit([E]), covering.limit([D])
    assert quick > 30.0
    assert slow > quick + 90.0
    assert part_of(Path("design/active/repulsion.py")) == "active design"
    assert near("active design")[:3] == ["unit/calibration", "unit/design", "study/calibration"]


TIMED = """
import time
import pytest

@pytest.fixture(scope="module")
def slow():
    time.sleep(0.05)

@pytest.mark.parametrize("case", [1, 2])
def test_it(slow, case):
    pass
"""


def test_tables_of_seconds_have_a_row_for_each_file_and_fixture(tmp_path):
    (tmp_path / "test_it.py").write_text(TIMED, "utf-8")
    options = ["-q", "-p", "no:cacheprovider", "--rootdir", str(tmp_path), "-c", "/dev/null", str(tmp_path)]
    command = [sys.executable, "-m", "verification.suite_seconds", "--most", "2", *options]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    lines = [line.split() for line in done.stdout.splitlines() if line.strip()]
    assert ["seconds", "by", "file", "cases", "compile", "solve", "programs", "waiting", "rest"] in lines
    rows = {line[0]: [float(figure) for figure in line[1:]] for line in lines if line[0] in ("all", "test_it.py")}
    assert rows["all"] == rows["test_it.py"]
    assert rows["all"][0] == 2
    (fixture,) = (line for line in lines if line[0].endswith("::slow"))
    assert [float(figure) for figure in fixture[1:]] == [1, 0.1]
