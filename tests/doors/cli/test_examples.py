"""Each example that `strandline init` writes is sound, and finds the truth."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from tests.unit.cli.command_line import Shown, printed

import strandline
from strandline.studies.examples import EXAMPLES, write_example

TRUTH = {
    "biofilm": {"E": 400.0, "nu": 0.3},
    "python": {"B": 40.0, "tilt": 1.0},
    "command": {"E": 400.0},
    "creep": {"E": 300.0, "nu": 0.35, "ratio": 1.2, "tau": 4.0},
    "pendant-drop": {"gamma": 72.4},
    "oct": {"E": 400.0, "nu": 0.3},
}
SLOW = {"biofilm", "oct"}
"""Examples that solve for the flow as `creep` does."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.long) if name in SLOW else name for name in EXAMPLES]
)
def test_an_example_is_sound(name: str, tmp_path: Path, capsys: Shown) -> None:
    if name == "calculix" and not shutil.which("ccx"):
        pytest.skip("needs ccx")
    write_example(name, tmp_path / "study")
    assert "study: study.yaml is sound" in printed(capsys, "check", str(tmp_path / "study"))


@pytest.mark.parametrize(
    "name", [name if name == "python" else pytest.param(name, marks=pytest.mark.long) for name in TRUTH]
)
def test_an_example_finds_the_truth(name: str, tmp_path: Path) -> None:
    write_example(name, tmp_path / "study")
    draft = ["--set", "draft=true", "--set", "report=none"]
    words = [sys.executable, "-m", "strandline", "run", "study", "--quiet", "--json", *draft]
    path = os.pathsep.join(map(str, [Path(strandline.__file__).parents[1], *sys.path]))
    environment = {**os.environ, "PYTHONPATH": path}
    done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr
    inputs = json.loads(done.stdout)["inputs"]
    for one, true in TRUTH[name].items():
        assert abs(inputs[one]["mean"] - true) < 3 * inputs[one]["sd"], inputs[one]
