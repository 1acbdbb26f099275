"""A Python model beside study.yaml: found without PYTHONPATH, never mixed up, and the same model as before."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from strandline.errors import InvalidInput, InvalidStudy
from strandline.models.beside import lies_in, modules_of
from strandline.models.protocol import fingerprint
from strandline.models.python import PythonModel
from strandline.runs import LocalProcesses, RunRequest
from strandline.studies import load_study
from strandline.studies.build import build_model

BEAM = """import {sibling}

def bend(inputs, workdir):
    import lazily_beside
    return [[0.0, 0.0], [lazily_beside.LENGTH, {sibling}.SLOPE * inputs["a"]]]
"""
STUDY = """version: 1
name: line
model: {python: {function: "beside_beam:bend"}}
inputs: {a: {prior: {uniform: [0.5, 1.5]}}}
observation: {synthetic: {a: 1}}
discrepancy: {tracked_points: {}}
noise: {sd: 0.01}
design: {sobol: {runs: 8}}
"""


def study(folder: Path, slope: float, length: float) -> Path:
    folder.mkdir()
    (folder / "beside_beam.py").write_text(BEAM.format(sibling="beside_slope"))
    (folder / "beside_slope.py").write_text(f"SLOPE = {slope}\n")
    (folder / "lazily_beside.py").write_text(f"LENGTH = {length}\n")
    (folder / "study.yaml").write_text(STUDY)
    return folder


def end(model: PythonModel) -> list[float]:
    return [float(value) for value in model({"a": 1.0}, Path()).points[-1, :2]]


@pytest.fixture
def two(tmp_path: Path) -> tuple[Path, Path]:
    return study(tmp_path / "one", 2.0, 1.0), study(tmp_path / "other", 3.0, 5.0)


def test_two_folders_with_modules_of_the_same_names_do_not_mix(two: tuple[Path, Path]) -> None:
    models = [PythonModel("beside_beam:bend", folder=folder) for folder in two]
    assert [end(model) for model in models] == [[1.0, 2.0], [5.0, 3.0]]
    assert [end(model) for model in reversed(models)] == [[5.0, 3.0], [1.0, 2.0]]
    assert fingerprint(models[0]) != fingerprint(models[1])
    assert models[0] != models[1]


def test_nothing_stays_behind(two: tuple[Path, Path]) -> None:
    before, modules = list(sys.path), set(sys.modules)
    end(PythonModel("beside_beam:bend", folder=two[0]))
    assert sys.path == before
    assert not {name for name in set(sys.modules) - modules if "besid" in name and "strandline" not in name}
    with pytest.raises(InvalidInput, match="beside_beam"):
        PythonModel("beside_beam:bend")


def test_a_module_is_executed_once(tmp_path: Path) -> None:
    (tmp_path / "counted_beside.py").write_text(
        "from pathlib import Path\nwith Path(__file__).with_name('count').open('a') as file:\n    file.write('x')\n"
        "def f(inputs, workdir):\n    return [[0.0, 0.0], [1.0, 1.0]]\n"
    )
    for _ in range(3):
        end(PythonModel("counted_beside:f", folder=tmp_path))
    assert (tmp_path / "count").read_text() == "x"


def test_a_folder_inside_another_ones_turn(two: tuple[Path, Path]) -> None:
    one, other = (PythonModel("beside_beam:bend", folder=folder) for folder in two)
    with modules_of(one.folder):
        assert end(other) == [5.0, 3.0]
        assert end(one) == [1.0, 2.0]


def test_it_is_the_same_model_as_on_the_python_path(two: tuple[Path, Path]) -> None:
    """A ledger that was begun with PYTHONPATH stays valid."""
    program = (
        "from strandline.models.python import PythonModel; from strandline.models.protocol import fingerprint\n"
        "for alone in (False, True): print(fingerprint(PythonModel('beside_beam:bend', function_alone=alone)))"
    )
    for folder in two:
        path = os.pathsep.join([str(folder), *sys.path])
        done = subprocess.run(
            [sys.executable, "-c", program],
            env={**os.environ, "PYTHONPATH": path},
            capture_output=True,
            text=True,
            check=True,
        )
        models = (PythonModel("beside_beam:bend", function_alone=alone, folder=folder) for alone in (False, True))
        assert done.stdout.split() == [fingerprint(model) for model in models]


def test_it_does_not_depend_on_where_the_folder_lies(two: tuple[Path, Path], tmp_path: Path) -> None:
    moved = study(tmp_path / "moved", 2.0, 1.0)
    models = [PythonModel("beside_beam:bend", folder=folder) for folder in (two[0], moved)]
    assert fingerprint(models[0]) == fingerprint(models[1])
    assert str(tmp_path) not in repr(models[0])


def test_it_travels_to_worker_processes(
    two: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    model = PythonModel("beside_beam:bend", folder=Path("other"))
    monkeypatch.chdir("/")
    assert pickle.loads(pickle.dumps(model)) == model
    (record,) = LocalProcesses(workers=1)(model, [RunRequest("key", {"a": 1.0})])
    assert record.ok, record.message
    assert record.interface is not None
    np.testing.assert_array_equal(record.interface.points[-1, :2], [5.0, 3.0])


def test_a_study_finds_the_module_beside_it(two: tuple[Path, Path]) -> None:
    models = [load_study(folder).model for folder in two]
    assert all(isinstance(model, PythonModel) and model.folder for model in models)
    assert [end(model) for model in models if isinstance(model, PythonModel)] == [[1.0, 2.0], [5.0, 3.0]]


def test_packages_and_what_is_no_module_there(tmp_path: Path) -> None:
    (tmp_path / "beside_package").mkdir()
    (tmp_path / "beside_package" / "__init__.py").write_text("")
    (tmp_path / "beside_package" / "model.py").write_text("from .parts import f\n")
    (tmp_path / "beside_package" / "parts.py").write_text("def f(inputs, workdir):\n    return [[0, 0], [1, 7]]\n")
    (tmp_path / "queue.py").write_text("def f(inputs, workdir):\n    return None\n")
    assert end(PythonModel("beside_package.model:f", folder=tmp_path)) == [1.0, 7.0]
    assert "beside_package.model" not in sys.modules
    assert lies_in(tmp_path, "beside_package.model")
    assert not any(lies_in(tmp_path, name) for name in ("queue", "nothing", ""))
    assert PythonModel("strandline.testing.studies:beam", folder=tmp_path).folder is None


def test_the_folder_is_no_option_of_a_study(tmp_path: Path) -> None:
    with pytest.raises(InvalidStudy, match=r"unknown option.*folder"):
        build_model({"python": {"function": "strandline.testing.studies:beam", "folder": str(tmp_path)}}, tmp_path)


def test_a_missing_module_says_where_to_put_it(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput) as caught:
        PythonModel("nowhere_beside:f", folder=tmp_path)
    assert "put it beside study.yaml, install it, or put its folder on PYTHONPATH" in caught.value.remedy


def test_nothing_is_written_beside_the_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    (tmp_path / "quiet_beam.py").write_text("def beam(inputs, workdir):\n    return None\n")
    assert PythonModel("quiet_beam:beam", folder=tmp_path).conditions
    assert [path.name for path in tmp_path.iterdir()] == ["quiet_beam.py"]
    assert sys.dont_write_bytecode is False
