"""A Python model beside study.yaml: found without PYTHONPATH, never mixed up, and the same model as before."""

import pickle
import sys
from pathlib import Path

import pytest

from strandline.errors import InvalidInput, InvalidStudy
from strandline.models.beside import lies_in, modules_of
from strandline.models.protocol import fingerprint
from strandline.models.python import PythonModel
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


def test_folders_with_modules_of_the_same_names_do_not_mix(two: tuple[Path, Path]) -> None:
    before, modules = list(sys.path), set(sys.modules)
    models = one, other = [PythonModel("beside_beam:bend", folder=folder) for folder in two]
    assert [end(model) for model in models] == [[1.0, 2.0], [5.0, 3.0]]
    assert [end(model) for model in reversed(models)] == [[5.0, 3.0], [1.0, 2.0]]
    with modules_of(one.folder):
        assert end(other) == [5.0, 3.0]
        assert end(one) == [1.0, 2.0]
    assert fingerprint(one) != fingerprint(other)
    assert one != other
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


def test_it_is_the_same_model_as_on_the_python_path_and_wherever_the_folder_lies(
    two: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A ledger that was begun with PYTHONPATH stays valid."""
    beside = PythonModel("beside_beam:bend", folder=two[0])
    found = [beside, PythonModel("beside_beam:bend", folder=study(tmp_path / "moved", 2.0, 1.0))]
    alone = fingerprint(PythonModel("beside_beam:bend", function_alone=True, folder=two[0]))
    monkeypatch.syspath_prepend(two[0])
    found.append(PythonModel("beside_beam:bend"))
    assert len({fingerprint(model) for model in found}) == 1
    assert fingerprint(PythonModel("beside_beam:bend", function_alone=True)) == alone
    assert str(tmp_path) not in repr(beside)


def test_a_relative_folder_travels(two: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    model = PythonModel("beside_beam:bend", folder=Path("other"))
    monkeypatch.chdir("/")
    travelled = pickle.loads(pickle.dumps(model))
    assert travelled == model
    assert end(travelled) == [5.0, 3.0]


def test_a_study_finds_the_module_beside_it(two: tuple[Path, Path]) -> None:
    models = [load_study(folder).model for folder in two]
    assert all(isinstance(model, PythonModel) and model.folder for model in models)
    assert [end(model) for model in models if isinstance(model, PythonModel)] == [[1.0, 2.0], [5.0, 3.0]]


def test_packages_and_what_is_no_module_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
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
    assert not list(tmp_path.rglob("*.pyc"))
    assert sys.dont_write_bytecode is False


def test_what_cannot_be_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidStudy, match=r"unknown option.*folder"):
        build_model({"python": {"function": "strandline.testing.studies:beam", "folder": str(tmp_path)}}, tmp_path)
    with pytest.raises(InvalidInput) as caught:
        PythonModel("nowhere_beside:f", folder=tmp_path)
    assert "put it beside study.yaml, install it, or put its folder on PYTHONPATH" in caught.value.remedy
