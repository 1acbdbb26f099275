"""The biofilm model with an inflow that changes with time: quasi-static and transient runs, and what is refused."""

from typing import Any

import numpy as np
import pytest

from strandline.errors import ForwardModelError, InvalidInput
from strandline.models.biofilm import transient_cell
from strandline.models.biofilm.course import Course
from strandline.models.biofilm.model import Biofilm
from strandline.models.protocol import fingerprint, with_sensitivities

INPUTS = {"E": 400.0, "nu": 0.3, "V_in": 100.0}
STEADY = Biofilm(mesh="coarse")
RISE: dict[str, Any] = {
    "inflow": [[0, 0.2], [0.1, 0.8], [0.3, 0.8]],
    "times": {"half": 0.05, "risen": 0.1, "late": 0.3},
}


def model(**options: Any) -> Biofilm:
    return Biofilm.from_options(mesh="coarse", course={**RISE, **options})


def moved(result: Any, name: str) -> np.ndarray:
    return result.interfaces[name].points - STEADY.undeformed().points


def largest(points: np.ndarray) -> float:
    return float(np.linalg.norm(points, axis=1).max())


@pytest.fixture(scope="module")
def transient() -> Any:
    return model(motion="transient")(INPUTS)


def test_quasi_static_is_the_steady_state_of_each_moment_to_the_bit():
    result = model()(INPUTS)
    assert model().conditions == tuple(result.interfaces) == ("half", "risen", "late")
    for name, rate in (("half", 50.0), ("risen", 80.0), ("late", 80.0)):
        expected = STEADY({**INPUTS, "V_in": rate}).interface.points
        np.testing.assert_array_equal(result.interfaces[name].points, expected)


def test_quasi_static_sensitivities_are_those_of_the_steady_states():
    found = with_sensitivities(model())(INPUTS).sensitivities["half"]
    steady = with_sensitivities(STEADY)({**INPUTS, "V_in": 50.0}).sensitivities[""]
    np.testing.assert_array_equal(found["E"], steady["E"])
    np.testing.assert_array_equal(found["V_in"], 0.5 * steady["V_in"])


def test_transient_run_reaches_the_steady_state(transient):
    """What is left after 0.2 s, twenty times what the solid's motion takes, is the fluid's slow creep to its state."""
    expected = STEADY({**INPUTS, "V_in": 80.0}).interface.points
    late = transient.interfaces["late"].points
    assert largest(late - expected) < 0.03 * largest(expected - STEADY.undeformed().points)


def test_inertia_counts_while_the_flow_rises(transient):
    quasi = model()(INPUTS)
    assert largest(moved(transient, "half") - moved(quasi, "half")) > 0.05 * largest(moved(quasi, "half"))
    figures = transient.diagnostics
    assert 0 < figures["min_J_fluid_half"] < 1
    assert figures["newton_jacobians_late"] >= figures["newton_jacobians_half"] > 0


def test_result_follows_the_tolerance(transient):
    exact = model(motion="transient", tolerance=3e-5)(INPUTS)
    for name in ("half", "risen", "late"):
        assert largest(moved(transient, name) - moved(exact, name)) < 5e-3 * largest(moved(exact, "late"))


def test_same_inputs_same_bits_whatever_ran_before(transient):
    again = model(motion="transient")
    again({**INPUTS, "E": 900.0})
    np.testing.assert_array_equal(again(INPUTS).interfaces["risen"].points, transient.interfaces["risen"].points)


def test_slow_transient_run_is_quasi_static():
    slow = {"inflow": [[0, 0.2], [200, 0.8]], "times": [100.0]}
    found = model(**slow, motion="transient")(INPUTS).interfaces["t1"].points
    expected = model(**slow)(INPUTS).interfaces["t1"].points
    assert largest(found - expected) < 2e-3 * largest(expected - STEADY.undeformed().points)


def test_density_of_the_solid_changes_the_motion(transient):
    heavy = model(motion="transient", solid_density=8e3)(INPUTS)
    assert largest(moved(heavy, "half") - moved(transient, "half")) > 1e-3 * largest(moved(transient, "half"))


def test_first_time_is_the_steady_state_at_the_start():
    found = model(inflow=[[1, 0.5], [2, 1]], times=[1.0], motion="transient")(INPUTS)
    np.testing.assert_allclose(
        found.interfaces["t1"].points, STEADY({**INPUTS, "V_in": 50.0}).interface.points, rtol=1e-9
    )


def test_fields_are_those_of_the_time():
    chosen = model(times=[0.05, 0.3])
    early, late = (np.abs(chosen.fields(INPUTS, name).velocity).max() for name in ("t1", "t2"))
    np.testing.assert_allclose(late / early, 1.6, rtol=0.05)
    moving = model(times=[0.002, 0.3], motion="transient")
    assert np.abs(moving.fields(INPUTS, "t1").velocity).max() < 0.5 * late


def test_without_a_name_fields_are_those_of_the_strongest_flow():
    ending = model(inflow=[[0, 0], [0.1, 0.5], [0.3, 0.5], [0.4, 0]], times={"early": 0.1, "late": 0.3, "after": 0.4})
    shown = ending.fields(INPUTS)
    np.testing.assert_array_equal(shown.velocity, ending.fields(INPUTS, "late").velocity)
    assert np.abs(shown.velocity).max() > 1e3 * np.abs(ending.fields(INPUTS, "after").velocity).max()


def test_pressure_drop_follows_the_course():
    driven = Biofilm.from_options(mesh="coarse", inflow="pressure", course={**RISE, "motion": "transient"})
    found = driven({"E": 400.0, "nu": 0.3, "p_drop": 2.0})
    assert largest(moved(found, "late")) > 0


def test_a_run_without_a_state_tells_when_it_ended():
    with pytest.raises(ForwardModelError) as caught:
        model(inflow=[[0, 0], [0.02, 1]], times=[0.02], motion="transient")({"E": 20.0, "nu": 0.3, "V_in": 300.0})
    assert caught.value.kind in Biofilm.failure_kinds
    assert 0 <= caught.value.evidence["time"] < 0.02


def test_ledgers_of_other_courses_do_not_mix():
    texts = {fingerprint(m) for m in (STEADY, model(), model(motion="transient"), model(tolerance=1e-4))}
    assert len(texts) == 4


def test_finer_mesh_has_the_same_times():
    found = model(times=[0.05]).on_finer_mesh(INPUTS)
    assert largest(found["t1"].points - model(times=[0.05])(INPUTS).interfaces["t1"].points) < 1e-3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"times": [0.2, 0.1]}, "times in the course of the biofilm model: got 0.1 s after 0.2 s; expected times that"),
        ({"times": [0.1, 0.1]}, "0.1 s after 0.1 s"),
        ({"times": [0.1, 0.4]}, "got 0.4 s; expected times inside the course, from 0 to 0.3 s"),
        ({"times": [-0.1]}, "got -0.1 s; expected times inside"),
        ({"times": []}, "times in the course of the biofilm model: got none; expected at least one"),
        ({"times": 0.1}, "expected times in s by the name of the condition"),
        ({"times": {"a/b": 0.1}}, "expected names of conditions"),
        ({"times": {"a": "soon"}}, "expected a finite number"),
        ({"inflow": [[0, 0], [0.5, 1], [0.4, 2]]}, "times of the inflow in the course .* got 0.4 s after 0.5 s"),
        ({"inflow": [[0, 0], [0.5, -1]]}, "got share -1 at 0.5 s; expected shares of V_in, 0 or above"),
        ({"inflow": [[0, 0]]}, "expected a table of at least two pairs"),
        ({"inflow": "fast"}, "expected a table of at least two pairs"),
        ({"motion": "dynamic"}, "motion in the course .* got dynamic; expected one of quasi_static, transient"),
        ({"solid_density": 0}, "expected a density in kg/m\\^3 above 0"),
        ({"tolerance": 0.5}, "expected a share above 0, at most 0.1"),
        ({"tolerance": float("nan")}, "expected a finite number"),
        ({"speed": 1}, "expected a mapping with inflow and times"),
    ],
)
def test_bad_courses_are_refused_with_one_line(options, message):
    with pytest.raises(InvalidInput, match=message) as caught:
        model(**options)
    assert "\n" not in str(caught.value)
    assert str(caught.value).endswith("Correct the course.")


def test_a_course_is_a_mapping():
    with pytest.raises(InvalidInput, match="course of the biofilm model: got 3; expected a mapping"):
        Biofilm.from_options(course=3)
    assert Biofilm.from_options(course=Course.of(RISE)).course == Course.of(RISE)


@pytest.mark.parametrize("viscosity", [0.0, -1e-3])
def test_a_fluid_without_viscosity_is_refused(viscosity):
    with pytest.raises(InvalidInput, match="viscosity of the fluid"):
        Biofilm.from_options(course=RISE, fluid={"viscosity": viscosity})


def test_what_a_course_cannot_be_combined_with():
    with pytest.raises(InvalidInput, match="got sensitivities with motion: transient; expected motion: quasi_static"):
        with_sensitivities(model(motion="transient"))
    with pytest.raises(InvalidInput, match="got a course with inflow_rates or pressure_drops; expected one of the two"):
        Biofilm.from_options(course=RISE, inflow_rates={"slow": 50})


def test_scale_of_time_is_that_of_length_and_velocity():
    assert transient_cell.TIME_SCALE == 0.01
