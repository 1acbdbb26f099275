"""The adapter to a Python function."""

import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strandline.errors import ForwardModelError, InvalidInput
from strandline.interface import Interface
from strandline.models.protocol import Simulation, declared_inputs, fingerprint
from strandline.models.python import PythonModel
from strandline.runs import LocalProcesses, RunRequest, attempt
from strandline.testing.studies import beam

INPUTS = {"E": 400.0, "tilt": 0.02, "load": 1e-5}
SOURCE = """
def points(inputs, workdir):
    return [[0.0, 0.0], [1.0, inputs["a"]]]

def ragged(inputs, workdir):
    return [[0.0, 0.0], [1.0]]

def solid(inputs, workdir):
    return [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]

def text(inputs, workdir):
    return "done"

NUMBER = 3
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "my_adapter_model.py").write_text(SOURCE)
    monkeypatch.syspath_prepend(tmp_path)
    return "my_adapter_model"


def outcome(function: str, inputs: Mapping[str, float], tmp_path: Path) -> Any:
    return attempt(PythonModel(function), RunRequest("key", dict(inputs)), tmp_path)


def test_calls_the_function(tmp_path: Path) -> None:
    simulation = PythonModel("strandline.testing.studies:beam")(INPUTS, tmp_path)
    assert isinstance(simulation, Simulation)
    np.testing.assert_array_equal(simulation.interface.points, beam(INPUTS, tmp_path).interface.points)
    assert simulation.diagnostics == {"tip": pytest.approx(0.12)}


def test_points_become_a_polyline(module: str, tmp_path: Path) -> None:
    interface = PythonModel(f"{module}:points")({"a": 0.5}, tmp_path)
    assert isinstance(interface, Interface)
    np.testing.assert_array_equal(interface.points, [[0.0, 0.0], [1.0, 0.5]])


@pytest.mark.parametrize("name", ["ragged", "solid", "text"])
def test_other_results_are_failures_of_the_run(module: str, tmp_path: Path, name: str) -> None:
    record = outcome(f"{module}:{name}", {"a": 0.5}, tmp_path)
    assert (record.state, record.failure_kind) == ("invalid", "not_an_interface")


def test_failures_come_through(tmp_path: Path) -> None:
    model = PythonModel("strandline.testing.studies:beam")
    with pytest.raises(ForwardModelError, match="large_deflection"):
        model({**INPUTS, "load": 1.0}, tmp_path)


def test_declared_inputs_and_fingerprint_are_the_functions_own() -> None:
    model = PythonModel("strandline.testing.studies:beam")
    assert [item.name for item in declared_inputs(model)] == ["E", "tilt", "load"]
    assert fingerprint(model) == "test:beam-1"


def test_without_a_fingerprint_the_source_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    prints = []
    for name, body in (("one_a", "return [[0, 0], [1, 1]]"), ("one_b", "return [[0, 0], [1, 2]]")):
        (tmp_path / f"{name}.py").write_text(f"def f(inputs, workdir):\n    {body}\n")
        prints.append(fingerprint(PythonModel(f"{name}:f")))
    assert declared_inputs(PythonModel("one_a:f")) == ()
    assert prints[0] == fingerprint(PythonModel("one_a:f"))
    assert prints[0] != prints[1]


def test_a_function_without_source_needs_a_fingerprint() -> None:
    with pytest.raises(InvalidInput, match="attribute `fingerprint`"):
        fingerprint(PythonModel("math:sin"))


def test_it_travels_to_worker_processes() -> None:
    model = PythonModel("strandline.testing.studies:beam")
    assert pickle.loads(pickle.dumps(model)) == model
    (record,) = LocalProcesses(workers=1)(model, [RunRequest("key", INPUTS)])
    assert record.ok
    assert record.interface is not None
    np.testing.assert_array_equal(record.interface.points, beam(INPUTS, Path()).interface.points)


@pytest.mark.parametrize(
    ("function", "words"),
    [
        ("simulate", "module:name"),
        (":simulate", "module:name"),
        ("no_such_module_anywhere:f", "no_such_module_anywhere"),
        ("strandline.nowhere:f", "strandline.nowhere"),
        ("my_adapter_model:nothing", "a callable nothing in my_adapter_model"),
        ("my_adapter_model:NUMBER", "a callable NUMBER"),
        ("broken_adapter_model:f", "SyntaxError"),
        ("needy_adapter_model:f", "no_such_dependency"),
    ],
)
def test_what_cannot_be_found(module: str, tmp_path: Path, function: str, words: str) -> None:
    (tmp_path / "broken_adapter_model.py").write_text("def f(:\n")
    (tmp_path / "needy_adapter_model.py").write_text("import no_such_dependency\n")
    with pytest.raises(InvalidInput) as caught:
        PythonModel(function)
    assert words in str(caught.value)
    assert "PYTHONPATH" in caught.value.remedy
