"""The adapter to a Python function."""

from pathlib import Path

import numpy as np
import pytest

from strandline.errors import ForwardModelError, InvalidInput
from strandline.interface import Interface
from strandline.models.protocol import Simulation, declared_inputs, fingerprint
from strandline.models.python import PythonModel
from strandline.runs import RunRequest, attempt
from strandline.testing.studies import beam

INPUTS = {"E": 400.0, "tilt": 0.02, "load": 1e-5}
BEAM = "strandline.testing.studies:beam"
SOURCE = """
def points(inputs, workdir):
    return [[0.0, 0.0], [1.0, inputs["a"]]]

def other_points(inputs, workdir):
    return [[0.0, 0.0], [1.0, 2 * inputs["a"]]]

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


def test_it_calls_the_function_and_passes_its_failures_on(tmp_path: Path) -> None:
    model = PythonModel(BEAM)
    simulation = model(INPUTS, tmp_path)
    assert isinstance(simulation, Simulation)
    np.testing.assert_array_equal(simulation.interface.points, beam(INPUTS, tmp_path).interface.points)
    assert simulation.diagnostics == {"tip": pytest.approx(0.12)}
    with pytest.raises(ForwardModelError, match="large_deflection"):
        model({**INPUTS, "load": 1.0}, tmp_path)


def test_points_become_a_polyline_and_other_results_a_failure(module: str, tmp_path: Path) -> None:
    interface = PythonModel(f"{module}:points")({"a": 0.5}, tmp_path)
    assert isinstance(interface, Interface)
    np.testing.assert_array_equal(interface.points, [[0.0, 0.0], [1.0, 0.5]])
    for name in ("ragged", "solid", "text"):
        record = attempt(PythonModel(f"{module}:{name}"), RunRequest("key", {"a": 0.5}), tmp_path)
        assert (record.state, record.failure_kind) == ("invalid", "not_an_interface")


def test_inputs_and_fingerprint_are_those_of_the_function_or_its_source(module: str) -> None:
    assert [item.name for item in declared_inputs(PythonModel(BEAM))] == ["E", "tilt", "load"]
    assert fingerprint(PythonModel(BEAM)) == "test:beam-1"
    one, other = (PythonModel(f"{module}:{name}") for name in ("points", "other_points"))
    assert declared_inputs(one) == ()
    assert fingerprint(one) == fingerprint(PythonModel(f"{module}:points")) != fingerprint(other)
    with pytest.raises(InvalidInput, match="attribute `fingerprint`"):
        fingerprint(PythonModel("math:sin"))


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
def test_what_cannot_be_found_is_refused(module: str, tmp_path: Path, function: str, words: str) -> None:
    (tmp_path / "broken_adapter_model.py").write_text("def f(:\n")
    (tmp_path / "needy_adapter_model.py").write_text("import no_such_dependency\n")
    with pytest.raises(InvalidInput) as caught:
        PythonModel(function)
    assert words in str(caught.value)
    assert "PYTHONPATH" in caught.value.remedy
