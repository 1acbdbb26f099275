"""A Python function as the model: its results, its module beside study.yaml, and the sources that identify it."""

import importlib
import pickle
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from strandline.foundations import InvalidInput
from strandline.models.identity import fingerprint, sources_of
from strandline.models.protocol import declared_inputs
from strandline.models.python import PythonModel, lies_in, modules_of
from strandline.runs import RunRequest, attempt
from strandline.studies import load_study
from strandline.testing.studies import write_study

BEAM = "strandline.testing.studies:beam"


def written(folder, modules):
    for name, text in modules.items():
        path = folder / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder


RESULTS = """import math
def points(inputs, workdir): return [[0.0, 0.0], [1.0, inputs["a"]]]
def other_points(inputs, workdir): return [[0.0, 0.0], [1.0, 2 * inputs["a"]]]
def ragged(inputs, workdir): return [[0.0, 0.0], [1.0]]
def solid(inputs, workdir): return [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]
def text(inputs, workdir): return "done"
NUMBER = 3
def ring(inputs, workdir):
    points = [[math.cos(0.1 * k * math.pi), math.sin(0.1 * k * math.pi)] for k in range(21)]
    return points if inputs["a"] else points[:-1]
"""


@pytest.fixture
def adapter(tmp_path, monkeypatch):
    broken = {"broken_adapter": "def f(:\n", "lonely_adapter": "\nimport no_such_module_anywhere\n"}
    monkeypatch.syspath_prepend(written(tmp_path, {"my_adapter": RESULTS, **broken}))


def test_points_become_a_polyline_and_other_results_a_failure(adapter, tmp_path):
    found = PythonModel("my_adapter:points")({"a": 0.5}, tmp_path)
    np.testing.assert_array_equal(found.points, [[0.0, 0.0], [1.0, 0.5]])
    for name in ("ragged", "solid", "text"):
        record = attempt(PythonModel(f"my_adapter:{name}"), RunRequest("key", {"a": 0.5}), tmp_path)
        assert (record.state, record.failure_kind) == ("invalid", "not_an_interface")
    assert PythonModel("my_adapter:ring")({"a": 1.0}, tmp_path).closed
    record = attempt(PythonModel("my_adapter:ring"), RunRequest("key", {"a": 0.0}), tmp_path)
    assert "closed=True" in record.message


def test_inputs_and_fingerprint_are_those_of_the_function_or_its_source(adapter):
    assert [item.name for item in declared_inputs(PythonModel(BEAM))] == ["E", "tilt", "load"]
    assert fingerprint(PythonModel(BEAM)) == "test:beam-1"
    one, other = (PythonModel(f"my_adapter:{name}") for name in ("points", "other_points"))
    assert declared_inputs(one) == ()
    assert fingerprint(one) == fingerprint(PythonModel("my_adapter:points")) != fingerprint(other)


def test_what_cannot_be_found_is_refused(adapter, tmp_path):
    missing = "put the module beside study.yaml, install it, or put its folder on PYTHONPATH"
    for function, words, remedy in (
        (":simulate", "module:name", missing),
        ("no_such_module_anywhere:f", "no_such_module_anywhere", missing),
        ("my_adapter:NUMBER", "a function or another callable", "Correct the name."),
        ("broken_adapter:f", "SyntaxError: invalid syntax (broken_adapter.py, line 1))", "the module broken_adapter."),
        ("lonely_adapter:f", "in lonely_adapter.py, line 2)", "lonely_adapter, or install what it imports."),
    ):
        with pytest.raises(InvalidInput) as caught:
            PythonModel(function, folder=tmp_path)
        assert words in str(caught.value)
        assert remedy in caught.value.remedy


BESIDE = """import beside_slope

def bend(inputs, workdir):
    import lazily_beside
    return [[0.0, 0.0], [lazily_beside.LENGTH, beside_slope.SLOPE * inputs["a"]]]
"""
BEND = "beside_beam:bend"


def study(folder, slope, length):
    write_study(
        folder,
        model={"python": {"function": BEND}},
        fixed=None,
        inputs={"a": {"prior": {"uniform": [0.5, 1.5]}}},
        observation={"synthetic": {"a": 1}},
    )
    numbers = {"beside_slope": f"SLOPE = {slope}\n", "lazily_beside": f"LENGTH = {length}\n"}
    return written(folder, {"beside_beam": BESIDE, **numbers})


def end(model):
    return [float(value) for value in model({"a": 1.0}, Path()).points[-1, :2]]


@pytest.fixture
def two(tmp_path):
    return study(tmp_path / "one", 2.0, 1.0), study(tmp_path / "other", 3.0, 5.0)


def test_folders_with_modules_of_the_same_names_do_not_mix(two, monkeypatch):
    elsewhere = ModuleType("beside_slope")
    monkeypatch.setitem(sys.modules, "beside_slope", elsewhere)
    before, modules = list(sys.path), set(sys.modules)
    models = one, other = [load_study(folder).model for folder in two]
    assert [end(model) for model in models] == [[1.0, 2.0], [5.0, 3.0]]
    assert [end(model) for model in reversed(models)] == [[5.0, 3.0], [1.0, 2.0]]
    with modules_of(one.folder):
        assert end(other) == [5.0, 3.0]
        assert end(one) == [1.0, 2.0]
    assert fingerprint(one) != fingerprint(other)
    assert one != other
    assert sys.path == before
    assert sys.modules["beside_slope"] is elsewhere
    assert not {name for name in set(sys.modules) - modules if "besid" in name and "strandline" not in name}
    with pytest.raises(InvalidInput, match="beside_beam"):
        PythonModel(BEND)


def test_it_is_the_same_model_as_on_the_python_path_and_wherever_the_folder_lies(two, tmp_path, monkeypatch):
    """A ledger that was begun with PYTHONPATH stays valid; a relative folder travels."""
    monkeypatch.chdir(tmp_path)
    beside = PythonModel(BEND, folder=Path("one"))
    monkeypatch.chdir("/")
    assert pickle.loads(pickle.dumps(beside)) == beside
    assert end(pickle.loads(pickle.dumps(beside))) == [1.0, 2.0]
    found = [beside, PythonModel(BEND, folder=study(tmp_path / "moved", 2.0, 1.0))]
    monkeypatch.syspath_prepend(two[0])
    found.append(PythonModel(BEND))
    assert len({fingerprint(model) for model in found}) == 1


def test_packages_and_what_is_no_module_there(tmp_path):
    parts = {"model": "from .parts import f\n", "parts": "def f(inputs, workdir): return [[0, 0], [1, 7]]\n"}
    written(tmp_path / "beside_package", {"__init__": "", **parts})
    assert end(PythonModel("beside_package.model:f", folder=tmp_path)) == [1.0, 7.0]
    assert "beside_package.model" not in sys.modules
    assert lies_in(tmp_path, "beside_package.model")
    assert not lies_in(tmp_path, "nothing")
    assert PythonModel(BEAM, folder=tmp_path).folder is None


FILES = {
    "beside_model": "WIDTH = 2.0\n",
    "unrelated_model": "NOTHING = 0\n",
    "fp_package/__init__": "from fp_package import constants\n",
    "fp_package/constants": "LENGTH = 1.0\n",
    "fp_package/deep/__init__": "",
    "fp_package/deep/shape": "from ..constants import LENGTH\n\ndef height(a):\n    return LENGTH * a\n",
    "fp_package/unused": "NEVER = 1\n",
    "fp_package/model": """import numpy as np

def lift(a):
    from .deep import shape
    import beside_model
    return beside_model.WIDTH * shape.height(a)

def f(inputs, workdir):
    return [[0.0, 0.0], [1.0, lift(inputs["a"])]]
""",
}


def covered(module):
    return [name for name, _ in sources_of(module)]


@pytest.fixture
def package(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(written(tmp_path, FILES))
    return tmp_path


def forget():
    for name in [name for name in sys.modules if name.partition(".")[0] in ("fp_package", "beside_model")]:
        del sys.modules[name]
    importlib.invalidate_caches()


def identity():
    forget()
    return fingerprint(PythonModel("fp_package.model:f"))


def test_a_change_of_what_the_function_calls_is_another_model(package):
    before = identity()
    for name in ("fp_package/model.py", "fp_package/deep/shape.py", "fp_package/constants.py"):
        text = (package / name).read_text()
        changed = text.replace("1.0\n", "1.5\n").replace("* a", "* a * a").replace("WIDTH *", "WIDTH +")
        assert changed != text
        (package / name).write_text(changed)
        assert identity() != before
        (package / name).write_text(text)
    written(package, dict.fromkeys(("unrelated_model", "fp_package/unused"), "CHANGED = 1\n"))
    assert identity() == before


def test_of_an_installed_package_its_own_modules_count_and_of_strandline_its_version(package, monkeypatch):
    used = ["fp_package", "fp_package.constants", "fp_package.deep", "fp_package.deep.shape", "fp_package.model"]
    assert covered("fp_package.model") == ["beside_model", *used]
    site = package / "site-packages"
    site.mkdir()
    for name in ("fp_package", "beside_model.py"):
        (package / name).rename(site / name)
    monkeypatch.syspath_prepend(site)
    forget()
    assert covered("fp_package.model") == used
    assert covered("strandline.testing.studies") == ["strandline.testing.studies"]
