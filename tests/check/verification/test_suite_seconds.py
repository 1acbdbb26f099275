"""The seconds of tests, by file and by fixture."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]
TESTS = """
import time
import pytest

@pytest.fixture(scope="module")
def slow():
    time.sleep(0.05)

def test_one(slow):
    pass

def test_two(slow):
    pass
"""


def test_tables_have_a_row_for_each_file_and_fixture(tmp_path: Path) -> None:
    (tmp_path / "test_it.py").write_text(TESTS, "utf-8")
    options = ["-q", "-p", "no:cacheprovider", "--rootdir", str(tmp_path), "-c", "/dev/null", str(tmp_path)]
    command = [sys.executable, "-m", "verification.suite_seconds", "--most", "2", *options]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    lines = [line.split() for line in done.stdout.splitlines()]
    (head,) = (line for line in lines if line[:3] == ["seconds", "by", "file"])
    assert head[3:] == ["cases", "compile", "solve", "programs", "waiting", "rest"]
    rows = {
        line[0]: [float(figure) for figure in line[1:]] for line in lines if line and line[0] in ("all", "test_it.py")
    }
    assert rows["all"] == rows["test_it.py"]
    assert rows["all"][0] == 2
    assert rows["all"][4] >= 0.0
    (fixture,) = (line for line in lines if line and line[0].endswith("::slow"))
    assert [float(figure) for figure in fixture[1:]] == [1, 0.1]
