"""A biofilm over time: closed forms, orders, limits, and what a run depends on."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from tests.unit.models.biofilm.cells import INPUTS, failure, rough
from verification.validation.creep import creep_error, oscillation_errors, relaxation_error

from strandline.models.biofilm.memory import Branch
from strandline.models.biofilm.model import Biofilm

ONE = {"ratio": 1.5, "tau": 3.0}


def creeping(times: Any = (1, 5), inflow: Any = None, branches: int = 1, **options: Any) -> Biofilm:
    """Return a biofilm on which the whole inflow acts from 0 s on, unless another inflow is given."""
    named = times if isinstance(times, dict) else {f"{time:g} s": time for time in times}
    course = {"inflow": inflow or [[0, 0], [0, 1], [max(named.values()), 1]], "times": named}
    course |= {"tolerance": options.pop("tolerance")} if "tolerance" in options else {}
    return rough(**{"material": "neo_hookean", "course": course, "branches": branches, **options})


def interfaces(model: Biofilm, inputs: Mapping[str, float]) -> list[np.ndarray]:
    return [interface.points for interface in model(inputs).interfaces.values()]


def steady(young: float) -> np.ndarray:
    return rough(material="neo_hookean")(INPUTS | {"E": young}).interface.points


def test_relaxation_is_exact_while_strains_change_linearly() -> None:
    for poisson in (-0.2, 0.4999):
        assert relaxation_error(poisson) < 1e-12


def test_an_oscillation_is_of_second_order_and_a_scheme_of_first_order_is_noticed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    errors = oscillation_errors([16, 32])
    assert errors[1] < 1e-3
    assert np.log2(errors[0] / errors[1]) > 1.95

    def backward(branch: Branch, step: float) -> tuple[float, float]:
        left = 1.0 / (1.0 + step / branch.time)
        return left, branch.ratio * left

    monkeypatch.setattr(Branch, "over", backward)
    errors = oscillation_errors([8, 16])
    assert np.log2(errors[0] / errors[1]) < 1.4


def test_creep_in_a_slow_flow_keeps_to_the_tolerance() -> None:
    error, steps = creep_error(1e-2)
    assert error <= 1e-2
    assert steps < 60


def test_it_begins_unrelaxed_and_ends_relaxed_or_starts_so() -> None:
    first, last = interfaces(creeping([0, 15], tolerance=1e-2), INPUTS | {"ratio": 1.5, "tau": 0.5})
    np.testing.assert_allclose(first, steady(1000.0), rtol=0, atol=1e-9)
    np.testing.assert_allclose(last, steady(400.0), rtol=0, atol=1e-4)
    for points in interfaces(creeping([0, 3], [[0, 1], [3, 1]]), INPUTS | ONE):
        np.testing.assert_allclose(points, steady(400.0), rtol=0, atol=1e-8)


def test_a_run_depends_on_its_inputs_alone_and_branches_of_one_time_add_up() -> None:
    model = creeping([1, 3])
    one = interfaces(model, INPUTS | ONE)
    model(INPUTS | {"E": 150.0, "ratio": 0.3, "tau": 0.4})
    assert all(np.array_equal(a, b) for a, b in zip(one, interfaces(model, INPUTS | ONE), strict=True))
    two = {"ratio1": 0.5, "ratio2": 1.0, "tau1": 3.0, "tau2": 3.0}
    np.testing.assert_allclose(interfaces(creeping([1, 3], branches=2), INPUTS | two), one, rtol=0, atol=1e-9)


def test_a_ramp_in_an_instant_is_a_sudden_change() -> None:
    sudden = interfaces(creeping([2, 4], [[0, 0], [0, 1], [2, 1], [2, 0.3], [4, 0.3]]), INPUTS | ONE)
    ramp = interfaces(creeping([2.0001, 4], [[0, 0], [0, 1], [2, 1], [2.0001, 0.3], [4, 0.3]]), INPUTS | ONE)
    np.testing.assert_allclose(sudden, ramp, rtol=0, atol=5e-6)


def test_a_solid_that_creeps_until_it_folds_says_when() -> None:
    model = creeping([1, 60], material="saint_venant_kirchhoff", tolerance=1e-2)
    found = failure(model, INPUTS | ONE | {"E": 140.0})
    assert found.kind in model.failure_kinds
    assert 1.0 < found.evidence["time"] < 60.0
    assert f"{found.evidence['time']:.4g} s" in found.message


def test_the_fields_are_those_of_the_time() -> None:
    model = creeping([0, 3], [[0, 0], [0, 1], [2, 1], [2, 0], [3, 0]])
    speeds = [np.abs(model.fields(INPUTS | ONE, name).velocity).max() for name in model.conditions]
    assert speeds[0] > 100.0
    assert speeds[1] < 0.1 * speeds[0]


def test_its_inputs_and_conditions() -> None:
    model = creeping({"soon": 0.5, "late": 20}, branches=2)
    assert [one.name for one in model.inputs] == ["E", "nu", "V_in", "ratio1", "tau1", "ratio2", "tau2"]
    assert [one.unit for one in model.inputs[3:5]] == ["1", "s"]
    assert model.conditions == ("soon", "late")
    for item in model.inputs[3:]:
        assert not item.admits(0.0)
        assert item.admits(1e-3)
