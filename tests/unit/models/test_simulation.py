"""Simulations of several conditions, sensitivities, and what a model declares of both."""

import pickle
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strandline.errors import ForwardModelError, InvalidInput
from strandline.interface import Interface
from strandline.models.protocol import (
    Simulation,
    asks_sensitivities,
    declared_conditions,
    fingerprint,
    require_conditions,
    with_sensitivities,
)
from strandline.models.python import PythonModel
from strandline.testing.models import Cantilever, TwoLoads

LINE = Interface.polyline(np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 1.0]]))
INPUTS = {"E": 400.0, "load": 1e-5}


@dataclass(frozen=True)
class Plain:
    """A model without a fingerprint of its own."""

    size: float = 1.0

    def __call__(self, inputs: Any, workdir: Path) -> Interface:
        return LINE


@dataclass(frozen=True)
class Sensitive:
    """One that offers sensitivities."""

    size: float = 1.0
    sensitivities: bool = False

    def __call__(self, inputs: Any, workdir: Path) -> Simulation:
        return Simulation.of(LINE, sensitivities={"E": LINE.points} if self.sensitivities else {})


def test_one_condition_needs_no_name_and_several_have_theirs() -> None:
    simulation = Simulation.of(LINE, {"steps": 3.0}, {"E": LINE.points})
    assert simulation.interface is LINE
    assert dict(simulation.interfaces) == {"": LINE}
    assert dict(simulation.diagnostics) == {"steps": 3.0}
    assert list(simulation.sensitivities[""]) == ["E"]
    assert Simulation.of(LINE).sensitivities == {}
    assert Simulation({"slow": LINE}).interface is LINE
    with pytest.raises(InvalidInput, match="conditions slow, fast; expected one condition"):
        _ = Simulation({"slow": LINE, "fast": LINE}).interface


def test_conditions_are_declared_and_an_observed_one_must_be_among_them() -> None:
    for model, beam in ((Cantilever(), "beam"), (TwoLoads(), "two_loads")):
        named = declared_conditions(model)
        assert named == declared_conditions(PythonModel(f"strandline.testing.studies:{beam}"))
        require_conditions(named, model)
    assert declared_conditions(Cantilever()) == ("",)
    with pytest.raises(InvalidInput, match="got heavier; expected one of light, heavy"):
        require_conditions(["light", "heavier"], TwoLoads())
    with pytest.raises(InvalidInput, match="got light; expected no name"):
        require_conditions(["light"], Cantilever())


def test_sensitivities_are_no_part_of_the_identity() -> None:
    for model in (Sensitive(), TwoLoads(), PythonModel("strandline.testing.studies:two_loads")):
        asked = with_sensitivities(model)
        assert not asks_sensitivities(model)
        assert asks_sensitivities(asked)
        assert fingerprint(asked) == fingerprint(model) == fingerprint(pickle.loads(pickle.dumps(asked)))
    assert fingerprint(Sensitive(size=2.0)) != fingerprint(Sensitive())
    for model in (Plain(), lambda inputs, workdir: LINE, PythonModel("strandline.testing.studies:beam")):
        with pytest.raises(InvalidInput, match="this model offers none"):
            with_sensitivities(model)
        assert not asks_sensitivities(model)


def test_a_python_model_hands_the_request_on(tmp_path: Path) -> None:
    model = PythonModel("strandline.testing.studies:two_loads")
    assert model(INPUTS, tmp_path).sensitivities == {}
    asked = with_sensitivities(model)(INPUTS, tmp_path)
    direct = TwoLoads(sensitivities=True)(INPUTS, tmp_path)
    np.testing.assert_array_equal(asked.sensitivities["heavy"]["E"], direct.sensitivities["heavy"]["E"])


@pytest.mark.parametrize("name", ["E", "load"])
def test_sensitivities_of_two_loads_are_central_differences(name: str, tmp_path: Path) -> None:
    model = TwoLoads(sensitivities=True)
    exact, errors = model(INPUTS, tmp_path).sensitivities, []
    for step in (1e-2, 1e-3):
        one, other = (model({**INPUTS, name: INPUTS[name] * (1 + s)}, tmp_path).interfaces for s in (step, -step))
        for condition in TwoLoads.conditions:
            found = (one[condition].points - other[condition].points) / (2 * step * INPUTS[name])
            slope = exact[condition][name]
            errors.append(np.abs(found - slope).max() / np.abs(slope).max())
    assert max(errors[:2]) < 2e-4
    assert max(errors[2:]) < 2e-6


def test_two_loads_are_the_beam_under_each(tmp_path: Path) -> None:
    run = TwoLoads(ratio=2.0)(INPUTS, tmp_path)
    for condition, load in (("light", 1e-5), ("heavy", 2e-5)):
        expected = Cantilever()({"E": 400.0, "load": load}, tmp_path).interface
        np.testing.assert_array_equal(run.interfaces[condition].points, expected.points)
    with pytest.raises(ForwardModelError, match="large_deflection"):
        replace(TwoLoads(), ratio=1e4)(INPUTS, tmp_path)
