"""Each example that `strandline init` writes is sound, and finds the truth."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import strandline
from strandline.cli import main
from strandline.studies.keys.template import EXAMPLES, write_example

TRUTH = {
    "biofilm": {"E": 400.0, "nu": 0.3},
    "python": {"B": 40.0, "tilt": 1.0},
    "command": {"E": 400.0},
    "stiffness-field": {"E": 484.9},  # mean over the region
    "creep": {"E": 300.0, "nu": 0.35, "ratio": 1.2, "tau": 4.0},
    "pendant-drop": {"gamma": 72.4},
    "oct": {"E": 400.0, "nu": 0.3},
    "calculix": {"mu": 22.0, "stiffening": 0.25, "p": 2.04},
}


def written(name, tmp_path):
    if name == "calculix" and not shutil.which("ccx"):
        pytest.skip("needs ccx")
    write_example(name, tmp_path / "study")


def long_unless(quick, names):
    return [name if quick(name) else pytest.param(name, marks=pytest.mark.long) for name in names]


@pytest.mark.parametrize("name", long_unless(lambda name: name not in {"biofilm", "oct"}, EXAMPLES))
def test_an_example_is_sound(name, tmp_path, capsys):
    written(name, tmp_path)
    main(["check", str(tmp_path / "study")])  # a machine under load says on standard error that it waits
    assert "study: study.yaml is sound" in capsys.readouterr().out


@pytest.mark.parametrize("name", long_unless(lambda name: name == "python", TRUTH))
def test_an_example_finds_the_truth(name, tmp_path):
    written(name, tmp_path)
    words = ["-m", "strandline", "run", "study", "--quiet", "--json", "--set", "draft=true", "--set", "report=none"]
    path = os.pathsep.join(map(str, [Path(strandline.__file__).parents[1], *sys.path]))
    options = {"cwd": tmp_path, "env": {**os.environ, "PYTHONPATH": path}, "timeout": 900}
    done = subprocess.run([sys.executable, *words], capture_output=True, text=True, **options)
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    inputs = summary["inputs"] | {field: one["functionals"]["mean"] for field, one in summary["fields"].items()}
    for one, true in TRUTH[name].items():
        assert abs(inputs[one]["mean"] - true) < 3 * inputs[one]["sd"], inputs[one]
