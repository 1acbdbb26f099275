"""What a model declares and offers: conditions, sensitivities, a fingerprint, an interface at rest, a cheaper one."""

import pickle
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from strandline.foundations import InvalidInput
from strandline.interface import Interface
from strandline.models.fidelities import CHEAPER, FIRST_PAIRS, WithCheaper, by_cheaper, first_runs, run_identity
from strandline.models.identity import fingerprint
from strandline.models.protocol import (
    Simulation,
    asks_sensitivities,
    declared_conditions,
    require_conditions,
    require_inputs,
    undeformed_interface,
    with_sensitivities,
)
from strandline.models.python import PythonModel
from strandline.testing.models import Cantilever, TwoLoads

LINE = Interface.polyline(np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 1.0]]))
INPUTS = {"E": 400.0, "load": 1e-5}


class Plain:
    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Interface:
        return LINE


def shaped(inputs: Mapping[str, float], workdir: Path, shape: object) -> Interface:
    return LINE


@dataclass(frozen=True)
class Sensitive(Plain):
    size: float = 1.0
    sensitivities: bool = False


@dataclass(frozen=True)
class Labelled(Sensitive):
    fingerprint = "mine-1"


@dataclass(frozen=True)
class Declared(Sensitive):
    fingerprint: ClassVar[str] = "mine-1"


@dataclass(frozen=True)
class Rod:
    """A straight rod whose number of nodes is its fidelity."""

    nodes: int = 9
    conditions: tuple[str, ...] = ("",)

    @property
    def fingerprint(self) -> str:
        return f"rod:{self.nodes}"

    def __call__(self, inputs: Mapping[str, float], workdir: Path) -> Simulation:
        x = np.linspace(0.0, 1.0, self.nodes)
        return Simulation.of(Interface.polyline(np.stack([x, inputs["slope"] * x], axis=1)))

    def undeformed(self) -> str:
        return f"{self.nodes} nodes"


def test_conditions_are_declared_and_an_observed_one_must_be_among_them():
    for model, beam, expected in ((Cantilever(), "beam", ("",)), (TwoLoads(), "two_loads", ("light", "heavy"))):
        named = declared_conditions(model)
        assert named == expected == declared_conditions(PythonModel(f"strandline.testing.studies:{beam}"))
        require_conditions(named, model)
    with pytest.raises(InvalidInput, match="got heavier; expected one of light, heavy"):
        require_conditions(["light", "heavier"], TwoLoads())


def test_all_inputs_of_a_run_are_declared_ones_in_the_units_of_the_model_and_none_is_missing():
    units = {"E": "Pa"}
    require_inputs(units, ["load"], Cantilever())
    require_inputs({"anything": "kPa"}, [], Plain())
    for wrong, fixed, message in (
        (units | {"E": "kPa"}, ["load"], "unit of E: got kPa; expected Pa"),
        (units, ["laod"], "Did you mean load?"),
        (units, [], "got nothing for load"),
    ):
        with pytest.raises(InvalidInput, match=message):
            require_inputs(wrong, fixed, Cantilever())


def test_sensitivities_are_no_part_of_the_identity():
    for model in (Sensitive(), PythonModel("strandline.testing.studies:two_loads")):
        asked = with_sensitivities(model)
        assert not asks_sensitivities(model)
        assert asks_sensitivities(asked)
        assert fingerprint(asked) == fingerprint(model) == fingerprint(pickle.loads(pickle.dumps(asked)))
    assert fingerprint(Sensitive(size=2.0)) != fingerprint(Sensitive())
    for model in (Plain(), PythonModel("strandline.testing.studies:beam")):
        with pytest.raises(InvalidInput, match="this model offers none"):
            with_sensitivities(model)


def test_options_count_where_a_class_states_one_fingerprint_for_all():
    assert fingerprint(Labelled()) == fingerprint(Labelled(sensitivities=True)) == "mine-1"
    assert fingerprint(Labelled(5.0)) == 'mine-1/{"size": 5.0}'
    assert fingerprint(Declared(5.0)) == "mine-1"


def test_the_arguments_of_a_partial_model_count_and_all_entries_of_a_long_array():
    long = np.zeros(5000)
    changed = long.copy()
    changed[2000] = 1.0
    models = [partial(shaped, shape=one) for one in (1.0, 2.0, long, changed)]
    assert len({fingerprint(one) for one in (*models, partial(Sensitive(), shape=1.0))}) == 5
    assert fingerprint(models[3]) == fingerprint(partial(shaped, shape=changed.copy()))


def test_a_model_without_source_states_its_own_fingerprint():
    made = {}
    exec("def model(inputs, workdir): ...\nclass Model:\n    def __call__(self, inputs, workdir): ...", made)
    for model, name in ((made["model"], "model"), (made["Model"](), "Model")):
        with pytest.raises(InvalidInput, match=f"source of the model: got {name}; .* `fingerprint`"):
            fingerprint(model)
    made["model"].fingerprint = "mine-2"
    assert fingerprint(made["model"]) == "mine-2"


def test_two_loads_are_the_beam_under_each_with_its_derivatives(tmp_path):
    """Central differences; and a Python model hands the request for sensitivities on."""
    python, model = PythonModel("strandline.testing.studies:two_loads"), TwoLoads(sensitivities=True)
    run = replace(model, ratio=2.0)(INPUTS, tmp_path)
    for condition, load in (("light", 1e-5), ("heavy", 2e-5)):
        expected = Cantilever()(INPUTS | {"load": load}, tmp_path).interface
        np.testing.assert_array_equal(run.interfaces[condition].points, expected.points)
    exact = model(INPUTS, tmp_path).sensitivities
    assert python(INPUTS, tmp_path).sensitivities == {}
    handed = with_sensitivities(python)(INPUTS, tmp_path).sensitivities
    for name in INPUTS:
        one, other = (model({**INPUTS, name: INPUTS[name] * (1 + s)}, tmp_path).interfaces for s in (1e-3, -1e-3))
        for condition in TwoLoads.conditions:
            found = (one[condition].points - other[condition].points) / (2e-3 * INPUTS[name])
            slope = exact[condition][name]
            assert np.abs(found - slope).max() < 2e-6 * np.abs(slope).max()
            np.testing.assert_array_equal(handed[condition][name], slope)


def test_the_undeformed_interface_is_given_lacking_or_refused():
    model = Plain()
    assert undeformed_interface(model) is None
    model.undeformed = lambda: LINE
    assert undeformed_interface(model) is LINE
    model.undeformed = lambda: LINE.points
    with pytest.raises(InvalidInput, match="got a ndarray"):
        undeformed_interface(model)


def test_a_mark_chooses_the_cheaper_model_and_its_address_and_all_else_is_the_models():
    """A first design runs both models at some inputs."""
    both, plain, marked = WithCheaper(Rod(9), Rod(3), 0.2), {"slope": 1.0}, by_cheaper({"slope": 1.0})
    assert [len(both(inputs, Path()).interface.points) for inputs in (plain, marked)] == [9, 3]
    assert fingerprint(both) == fingerprint(Rod(9))
    assert [run_identity(both, "rod:9", inputs) for inputs in (plain, marked)] == ["rod:9", "rod:3"]
    assert run_identity(Rod(9), "rod:9", marked) == "rod:9"
    travelled = pickle.loads(pickle.dumps(both))
    assert travelled.undeformed() == "9 nodes"
    assert declared_conditions(travelled) == ("",)
    with pytest.raises(AttributeError, match="on_finer_mesh"):
        travelled.on_finer_mesh({})
    inputs = [{"slope": float(k)} for k in range(5)]
    assert first_runs(Rod(), inputs) == inputs
    found = first_runs(both, inputs)
    assert [CHEAPER in one for one in found] == [True] * 5 + [False] * FIRST_PAIRS
    assert found[5:] == inputs[:FIRST_PAIRS]


def test_a_cheaper_model_that_does_not_fit_is_refused():
    for cheaper, cost, message in (
        (Rod(9), 0.2, "the model itself"),
        (Rod(3), 1.0, "above 0 and below 1"),
        (Rod(3, ("a",)), 0.2, "conditions of the cheaper model: got a; expected those of the model"),
    ):
        with pytest.raises(InvalidInput, match=message):
            WithCheaper(Rod(9), cheaper, cost)
