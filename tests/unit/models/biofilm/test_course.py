"""The biofilm model with an inflow that changes with time: quasi-static and transient runs."""

from typing import Any

import numpy as np
import pytest
from tests.unit.models.biofilm.cells import INPUTS, failure, largest, rough

from strandline.models.biofilm import transient_cell
from strandline.models.biofilm.course import Course
from strandline.models.biofilm.creep.pieces import Piece, pieces
from strandline.models.biofilm.model import Biofilm
from strandline.models.protocol import with_sensitivities

RISE: dict[str, Any] = {
    "inflow": [[0, 0.2], [0.1, 0.8], [0.3, 0.8]],
    "times": {"half": 0.05, "risen": 0.1, "late": 0.3},
}
START = {"inflow": [[0, 0.2], [0.1, 0.8]], "times": {"half": 0.01}, "motion": "transient"}


def model(**options: Any) -> Biofilm:
    return rough(course={**RISE, **options})


def shift(result: Any, name: str) -> np.ndarray:
    return result.interfaces[name].points - rough().undeformed().points


@pytest.fixture(scope="module")
def quasi() -> Any:
    return model()(INPUTS)


@pytest.fixture(scope="module")
def transient() -> Any:
    return model(motion="transient", tolerance=8e-3)(INPUTS)


def test_quasi_static_is_the_steady_state_of_each_moment_to_the_bit(quasi):
    assert model().conditions == tuple(quasi.interfaces) == ("half", "risen", "late")
    for name, rate in (("half", 50.0), ("risen", 80.0), ("late", 80.0)):
        expected = rough()({**INPUTS, "V_in": rate}).interface.points
        np.testing.assert_array_equal(quasi.interfaces[name].points, expected)
    found = with_sensitivities(model())(INPUTS).sensitivities["half"]
    steady = with_sensitivities(rough())({**INPUTS, "V_in": 50.0}).sensitivities[""]
    np.testing.assert_array_equal(found["E"], steady["E"])
    np.testing.assert_array_equal(found["V_in"], 0.5 * steady["V_in"])


def test_transient_run_lags_while_the_flow_rises_and_reaches_the_steady_state(transient, quasi):
    """What is left after 0.2 s, twenty times what the solid's motion takes, is the fluid's slow creep to its state."""
    late = shift(quasi, "late")
    assert largest(shift(transient, "late") - late) < 0.03 * largest(late)
    assert largest(shift(transient, "half") - shift(quasi, "half")) > 0.05 * largest(shift(quasi, "half"))
    figures = transient.diagnostics
    assert 0 < figures["min_J_fluid_half"] < 1
    assert figures["newton_jacobians_late"] >= figures["newton_jacobians_half"] > 0


def test_result_follows_tolerance_and_density_and_repeats_to_the_bit():
    usual = model(**START, tolerance=5e-3)
    first = usual(INPUTS)
    size = largest(shift(first, "half"))
    for options, low, high in (({"tolerance": 1e-3}, 1e-6, 6e-2), ({"solid_density": 8e3}, 1e-3, np.inf)):
        changed = model(**{**START, "tolerance": 5e-3, **options})(INPUTS)
        assert low * size < largest(shift(changed, "half") - shift(first, "half")) < high * size
    np.testing.assert_array_equal(usual(INPUTS).interfaces["half"].points, first.interfaces["half"].points)
    assert transient_cell.TIME_SCALE == 0.01


def test_slow_transient_run_is_quasi_static_from_its_first_time_on():
    slow = {"inflow": [[0, 0.2], [200, 0.8]], "times": [0.0, 100.0]}
    found, expected = (model(**slow, **motion)(INPUTS) for motion in ({"motion": "transient"}, {}))
    for name, tolerance in (("t1", 1e-7), ("t2", 2e-3)):
        size = largest(shift(expected, name))
        assert largest(shift(found, name) - shift(expected, name)) < tolerance * size


def test_fields_are_those_of_the_time_or_of_the_strongest_flow():
    inflow = [[0, 0], [0.1, 0.5], [0.3, 0.5], [0.4, 0]]
    ending = model(inflow=inflow, times={"early": 0.05, "late": 0.3, "after": 0.4})
    speeds = {name: np.abs(ending.fields(INPUTS, name).velocity).max() for name in ending.conditions}
    np.testing.assert_allclose(speeds["late"] / speeds["early"], 2.0, rtol=0.1)
    assert speeds["late"] > 1e3 * speeds["after"]
    np.testing.assert_array_equal(ending.fields(INPUTS).velocity, ending.fields(INPUTS, "late").velocity)
    moving = model(times=[0.002, 0.1], motion="transient")
    assert np.abs(moving.fields(INPUTS, "t1").velocity).max() < 0.6 * speeds["late"]


def test_pressure_drop_follows_the_course_and_a_run_without_a_state_tells_when_it_ended():
    driven = rough(inflow="pressure", course=START)
    assert largest(shift(driven({"E": 400.0, "nu": 0.3, "p_drop": 2.0}), "half")) > 0
    quick = {"inflow": [[0, 0], [0.02, 1]], "times": [0.02], "motion": "transient"}
    found = failure(model(**quick), {"E": 20.0, "nu": 0.3, "V_in": 300.0})
    assert found.kind in Biofilm.failure_kinds
    assert 0 <= found.evidence["time"] < 0.02


def test_finer_mesh_has_the_same_times():
    early = model(times=[0.05])
    error = early.on_finer_mesh(INPUTS)["t1"].points - early(INPUTS).interfaces["t1"].points
    assert 0 < largest(error) < 1e-3


def test_a_course_is_divided_where_something_happens():
    inflow = ((0.0, 0.0), (2.0, 1.0), (5.0, 1.0), (5.0, 0.0), (8.0, 0.0))
    divided = {
        (("a", 1.0), ("b", 5.0), ("c", 7.0)): [
            Piece(0.0, 1.0, 0.0, 0.5),
            Piece(1.0, 2.0, 0.5, 1.0),
            Piece(2.0, 5.0, 1.0, 1.0),
            Piece(5.0, 5.0, 1.0, 0.0),
            Piece(5.0, 7.0, 0.0, 0.0),
        ],
        (("a", 1.0),): [Piece(0.0, 1.0, 0.0, 0.5)],
    }
    for times, expected in divided.items():
        assert list(pieces(Course(inflow, times))) == expected
    assert list(pieces(Course(inflow, (("b", 5.0),))))[-1] == Piece(5.0, 5.0, 1.0, 0.0)


def test_the_share_at_a_jump_is_that_after_it():
    course = Course(((0.0, 0.0), (0.0, 1.0), (2.0, 0.5), (2.0, 0.0)), (("a", 1.0),))
    assert [course.share(time) for time in (0.0, 1.0, 2.0)] == [1.0, 0.75, 0.0]
    assert [course.share(time, before=True) for time in (0.0, 1.0, 2.0)] == [0.0, 0.75, 0.5]
