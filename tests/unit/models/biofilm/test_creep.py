"""A biofilm over time: closed forms, orders, limits, what a run depends on, and options that cannot be used."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from verification.validation.creep import creep_error, oscillation_errors, relaxation_error

from strandline.errors import ForwardModelError, InvalidInput
from strandline.models.biofilm.course import Course
from strandline.models.biofilm.creep.pieces import Piece, pieces
from strandline.models.biofilm.memory import Branch
from strandline.models.biofilm.model import Biofilm

INPUTS = {"E": 400.0, "nu": 0.3, "V_in": 100.0}
ONE = {"ratio": 1.5, "tau": 3.0}


def creeping(times: Any = (1, 5), inflow: Any = None, branches: int = 1, **options: Any) -> Biofilm:
    """Return a biofilm on which the whole inflow acts from 0 s on, unless another inflow is given."""
    named = times if isinstance(times, dict) else {f"{time:g} s": time for time in times}
    course = {"inflow": inflow or [[0, 0], [0, 1], [max(named.values()), 1]], "times": named}
    course |= {key: options.pop(key) for key in ("tolerance", "motion") if key in options}
    return Biofilm.from_options(
        **{"mesh": "coarse", "material": "neo_hookean", "course": course, "branches": branches, **options}
    )


def interfaces(model: Biofilm, inputs: Mapping[str, float]) -> list[np.ndarray]:
    return [interface.points for interface in model(inputs).interfaces.values()]


def steady(young: float, rate: float = 100.0) -> np.ndarray:
    return Biofilm(mesh="coarse", material="neo_hookean")({"E": young, "nu": 0.3, "V_in": rate}).interface.points


# Closed forms and orders


@pytest.mark.parametrize("poisson", [-0.2, 0.3, 0.4999])
def test_relaxation_is_exact_while_strains_change_linearly(poisson: float) -> None:
    assert relaxation_error(poisson) < 1e-12


def test_an_oscillation_is_of_second_order() -> None:
    errors = oscillation_errors([16, 32])
    assert errors[1] < 1e-3
    assert np.log2(errors[0] / errors[1]) > 1.95


def test_a_scheme_of_first_order_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    def backward(branch: Branch, step: float) -> tuple[float, float]:
        left = 1.0 / (1.0 + step / branch.time)
        return left, branch.ratio * left

    monkeypatch.setattr(Branch, "over", backward)
    errors = oscillation_errors([16, 32])
    assert np.log2(errors[0] / errors[1]) < 1.3


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3])
def test_creep_in_a_slow_flow_keeps_to_the_tolerance(tolerance: float) -> None:
    error, steps = creep_error(tolerance)
    assert error <= tolerance
    assert steps < 60


# Limits


def test_without_branches_it_is_the_steady_state_at_each_inflow() -> None:
    model = creeping([1, 2, 3], [[0, 0], [1, 1], [2, 1], [2, 0.5], [3, 0.5]], branches=0)
    found = interfaces(model, INPUTS)
    for points, rate in zip(found, (100.0, 50.0, 50.0), strict=True):
        np.testing.assert_array_equal(points, steady(400.0, rate))


def test_it_begins_unrelaxed_and_ends_relaxed() -> None:
    first, last = interfaces(creeping([0, 150]), INPUTS | ONE)
    np.testing.assert_allclose(first, steady(1000.0), rtol=0, atol=1e-9)
    np.testing.assert_allclose(last, steady(400.0), rtol=0, atol=1e-5)


def test_branches_of_one_time_add_up() -> None:
    two = {"ratio1": 0.5, "ratio2": 1.0, "tau1": 3.0, "tau2": 3.0}
    one = interfaces(creeping(), INPUTS | ONE)
    np.testing.assert_allclose(interfaces(creeping(branches=2), INPUTS | two), one, rtol=0, atol=1e-9)


def test_a_ramp_in_an_instant_is_a_sudden_change() -> None:
    sudden = interfaces(creeping([2, 4], [[0, 0], [0, 1], [2, 1], [2, 0.3], [4, 0.3]]), INPUTS | ONE)
    ramp = interfaces(creeping([2.0001, 4], [[0, 0], [0, 1], [2, 1], [2.0001, 0.3], [4, 0.3]]), INPUTS | ONE)
    np.testing.assert_allclose(sudden, ramp, rtol=0, atol=5e-6)


# Runs


@pytest.fixture(scope="module")
def repeated() -> tuple[list[np.ndarray], list[np.ndarray]]:
    model = creeping()
    first = interfaces(model, INPUTS | ONE)
    model(INPUTS | {"E": 150.0, "ratio": 0.3, "tau": 0.4})
    return first, interfaces(model, INPUTS | ONE)


def test_a_run_depends_on_its_inputs_alone(repeated: tuple[list[np.ndarray], list[np.ndarray]]) -> None:
    assert all(np.array_equal(a, b) for a, b in zip(*repeated, strict=True))


def test_a_solid_that_creeps_until_it_folds_says_when() -> None:
    model = creeping([1, 60], material="saint_venant_kirchhoff")
    with pytest.raises(ForwardModelError) as failed:
        model(INPUTS | ONE | {"E": 180.0})
    assert failed.value.kind in model.failure_kinds
    assert 1.0 < failed.value.evidence["time"] < 60.0
    assert f"{failed.value.evidence['time']:.4g} s" in failed.value.message


def test_the_fields_are_those_of_the_time() -> None:
    model = creeping([0, 30], [[0, 0], [0, 1], [20, 1], [20, 0], [30, 0]])
    speeds = [np.abs(model.fields(INPUTS | ONE, name).velocity).max() for name in model.conditions]
    assert speeds[0] > 100.0
    assert speeds[1] < 1e-6


def test_its_inputs_and_conditions() -> None:
    model = creeping({"soon": 0.5, "late": 20}, branches=2)
    assert [one.name for one in model.inputs] == ["E", "nu", "V_in", "ratio1", "tau1", "ratio2", "tau2"]
    assert [one.unit for one in model.inputs[3:5]] == ["1", "s"]
    assert model.conditions == ("soon", "late")


def test_all_that_changes_results_is_in_the_fingerprint() -> None:
    model = creeping()
    others = [
        creeping([1, 6]),
        creeping(branches=2),
        creeping(branches=0),
        creeping(tolerance=0.01),
        creeping(inflow=[[0, 0], [0, 0.9], [5, 0.9]]),
        creeping(mesh="default"),
    ]
    assert len({one.fingerprint for one in [model, *others]}) == 7
    assert replace(model).fingerprint == model.fingerprint


def test_a_run_starts_relaxed() -> None:
    model = creeping([0, 3], [[0, 1], [3, 1]])
    for points in interfaces(model, INPUTS | ONE):
        np.testing.assert_allclose(points, steady(400.0), rtol=0, atol=1e-9)


# Courses


def test_a_course_is_divided_where_something_happens() -> None:
    inflow = ((0.0, 0.0), (2.0, 1.0), (5.0, 1.0), (5.0, 0.0), (8.0, 0.0))
    course = Course(inflow, (("a", 1.0), ("b", 5.0), ("c", 7.0)))
    assert list(pieces(course)) == [
        Piece(0.0, 1.0, 0.0, 0.5),
        Piece(1.0, 2.0, 0.5, 1.0),
        Piece(2.0, 5.0, 1.0, 1.0),
        Piece(5.0, 5.0, 1.0, 0.0),
        Piece(5.0, 7.0, 0.0, 0.0),
    ]
    assert list(pieces(replace(course, times=(("b", 5.0),))))[-1] == Piece(5.0, 5.0, 1.0, 0.0)
    assert list(pieces(replace(course, times=(("a", 1.0),)))) == [Piece(0.0, 1.0, 0.0, 0.5)]


def test_the_share_at_a_jump_is_that_after_it() -> None:
    course = Course(((0.0, 0.0), (0.0, 1.0), (2.0, 0.5), (2.0, 0.0)), (("a", 1.0),))
    assert [course.share(time) for time in (0.0, 1.0, 2.0)] == [1.0, 0.75, 0.0]
    assert [course.share(time, before=True) for time in (0.0, 1.0, 2.0)] == [0.0, 0.75, 0.5]


@pytest.mark.parametrize(
    ("inflow", "words"),
    [
        ([[0, 0], [0, 1], [0, 0], [5, 1]], "0 s after 0 s"),
        ([[0, 1], [6, 1], [5, 0]], "5 s after 6 s"),
        ([[0, -1], [5, 1]], "share -1 at 0 s"),
    ],
)
def test_an_inflow_that_cannot_be_used(inflow: Any, words: str) -> None:
    with pytest.raises(InvalidInput, match=words):
        creeping(inflow=inflow)


def test_inertia_admits_no_jump() -> None:
    with pytest.raises(InvalidInput, match="0 s after 0 s"):
        creeping(branches=0, motion="transient")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"branches": 4}, "a whole number from 0 to 3"),
        ({"branches": True}, "a whole number from 0 to 3"),
        ({"inflow": [[0, 0], [5, 1]], "motion": "transient"}, "branches: 1 with motion: transient"),
        ({"course": None}, "branches: 1 with no course"),
        ({"tolerance": 0}, "a share above 0"),
        ({"sensitivities": True}, "sensitivities with branches: 1"),
    ],
)
def test_options_that_cannot_be_used(options: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidInput, match=words):
        creeping(**options)


@pytest.mark.parametrize("name", ["ratio", "tau"])
def test_a_branch_without_stiffness_or_time_is_outside_its_range(name: str) -> None:
    item = next(one for one in creeping().inputs if one.name == name)
    assert not item.admits(0.0)
    assert item.admits(1e-3)
