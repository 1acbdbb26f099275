"""What judges the tests: changes of the code that they should notice, and what becomes of each."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest
from verification.mutation.operators import mutants
from verification.mutation.results import fingerprint, known_results, name_of, record

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


def test_mistakes_are_made_one_at_a_time_but_messages_settings_and_axes_stay():
    made = [one for place in mutants(SOURCE) for one in place]
    found = {(one.before, one.after) for one in made}
    assert found >= MADE
    assert not {before for before, _ in found} & {"0.05", "2.0", "β + 1", "3"}
    for one in made:
        changed = one.applied(SOURCE)
        ast.parse(changed)
        before, after = SOURCE.encode(), changed.encode()
        assert after[: one.start] == before[: one.start]
        assert after.endswith(before[one.end :])
        assert before[: one.start].count(b"\n") + 1 == one.line


def test_what_is_recorded_is_read_again_until_the_text_of_its_file_changes(tmp_path):
    moves, recorded, kept = tmp_path / "moves.py", tmp_path / "recorded.csv", tmp_path / "kept.jsonl"
    moves.write_text("x = 1\ny = 1\n", "utf-8")
    texts = {"file": "moves.py", "text": fingerprint(moves), "line": "1", "test": "", "seconds": "3"}
    first = {**texts, "start": "30", "before": 'x, "β"', "after": "(x)", "end": "passed"}
    record([first, {**first, "start": "4", "end": "failed"}], recorded)
    assert [row["start"] for row in known_results(tmp_path, recorded, kept).values()] == ["4", "30"]
    kept.write_text(json.dumps({**first, "end": "failed"}) + "\n", "utf-8")
    assert known_results(tmp_path, recorded, kept)[name_of(first)]["end"] == "failed"
    moves.write_text("x = 2\n", "utf-8")
    assert known_results(tmp_path, recorded, kept) == {}


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
