"""Runs of the biofilm model through time: quasi-static, transient, and of a solid that creeps."""

import numpy as np
import pytest
from tests.unit.models.biofilm.cells import INPUTS, failure, largest, rough
from verification.validation.creep import creep_error, oscillation_errors, relaxation_error

from strandline.models.biofilm.equations.memory import Branch
from strandline.models.protocol import with_sensitivities

RISE = {"inflow": [[0, 0.2], [0.1, 0.8], [0.3, 0.8]], "times": {"half": 0.05, "risen": 0.1, "late": 0.3}}
START = {"inflow": [[0, 0.2], [0.1, 0.8]], "times": {"half": 0.01}, "motion": "transient"}


def model(**options):
    return rough(course={**RISE, **options})


def shift(result, name):
    return result.interfaces[name].points - rough().undeformed().points


@pytest.fixture(scope="module")
def quasi():
    return model()(INPUTS)


def test_quasi_static_is_the_steady_state_of_each_moment_to_the_bit(quasi):
    assert model().conditions == tuple(quasi.interfaces) == ("half", "risen", "late")
    for name, rate in (("half", 50.0), ("risen", 80.0), ("late", 80.0)):
        expected = rough()({**INPUTS, "V_in": rate}).interface.points
        np.testing.assert_array_equal(quasi.interfaces[name].points, expected)
    found = with_sensitivities(model())(INPUTS).sensitivities["half"]
    steady = with_sensitivities(rough())({**INPUTS, "V_in": 50.0}).sensitivities[""]
    np.testing.assert_array_equal(found["E"], steady["E"])
    np.testing.assert_array_equal(found["V_in"], 0.5 * steady["V_in"])


def test_transient_run_lags_while_the_flow_rises_and_reaches_the_steady_state(quasi):
    """What is left after 0.2 s, twenty times what the solid's motion takes, is the fluid's slow creep to its state."""
    transient, late = model(motion="transient", tolerance=8e-3)(INPUTS), shift(quasi, "late")
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


def test_fields_are_those_of_the_time_or_of_the_strongest_flow():
    inflow = [[0, 0], [0.1, 0.5], [0.3, 0.5], [0.4, 0]]
    ending = model(inflow=inflow, times={"early": 0.05, "late": 0.3, "after": 0.4})
    speeds = {name: np.abs(ending.fields(INPUTS, name).velocity).max() for name in ending.conditions}
    np.testing.assert_allclose(speeds["late"] / speeds["early"], 2.0, rtol=0.1)
    assert speeds["late"] > 1e3 * speeds["after"]
    np.testing.assert_array_equal(ending.fields(INPUTS).velocity, ending.fields(INPUTS, "late").velocity)


ONE = INPUTS | {"ratio": 1.5, "tau": 3.0}


def creeping(times, inflow=None, branches=1, tolerance=1e-3, **options):
    """Return a biofilm on which the whole inflow acts from 0 s on, unless another inflow is given."""
    inflow = inflow or [[0, 0], [0, 1], [times[-1], 1]]
    course = {"inflow": inflow, "times": times, "tolerance": tolerance}
    return rough(**{"material": "neo_hookean", "course": course, "branches": branches, **options})


def interfaces(model, inputs):
    return [interface.points for interface in model(inputs).interfaces.values()]


def steady(young):
    return rough(material="neo_hookean")(INPUTS | {"E": young}).interface.points


def test_an_oscillation_is_of_second_order_and_a_scheme_of_first_order_is_noticed(monkeypatch):
    errors = oscillation_errors([16, 32])
    assert errors[1] < 1e-3
    assert np.log2(errors[0] / errors[1]) > 1.95

    def backward(branch, step):
        left = 1.0 / (1.0 + step / branch.time)
        return left, branch.ratio * left

    monkeypatch.setattr(Branch, "over", backward)
    errors = oscillation_errors([8, 16])
    assert np.log2(errors[0] / errors[1]) < 1.4


def test_relaxation_is_exact_while_strains_change_linearly_and_creep_keeps_to_the_tolerance():
    assert max(relaxation_error(poisson) for poisson in (-0.2, 0.4999)) < 1e-12
    error, steps = creep_error(1e-2)
    assert error <= 1e-2
    assert steps < 60


def test_it_begins_unrelaxed_and_ends_relaxed_or_starts_so():
    first, last = interfaces(creeping([0, 15], tolerance=1e-2), ONE | {"tau": 0.5})
    np.testing.assert_allclose(first, steady(1000.0), rtol=0, atol=1e-9)
    np.testing.assert_allclose(last, steady(400.0), rtol=0, atol=1e-4)
    for points in interfaces(creeping([0, 3], [[0, 1], [3, 1]]), ONE):
        np.testing.assert_allclose(points, steady(400.0), rtol=0, atol=1e-8)


def test_a_run_depends_on_its_inputs_alone_and_branches_of_one_time_add_up():
    model = creeping([1, 3])
    one = interfaces(model, ONE)
    model(INPUTS | {"E": 150.0, "ratio": 0.3, "tau": 0.4})
    np.testing.assert_array_equal(interfaces(model, ONE), one)
    two = {"ratio1": 0.5, "ratio2": 1.0, "tau1": 3.0, "tau2": 3.0}
    np.testing.assert_allclose(interfaces(creeping([1, 3], branches=2), INPUTS | two), one, rtol=0, atol=1e-9)


def test_a_ramp_in_an_instant_is_a_sudden_change():
    sudden = interfaces(creeping([2, 4], [[0, 0], [0, 1], [2, 1], [2, 0.3], [4, 0.3]]), ONE)
    ramp = interfaces(creeping([2.0001, 4], [[0, 0], [0, 1], [2, 1], [2.0001, 0.3], [4, 0.3]]), ONE)
    np.testing.assert_allclose(sudden, ramp, rtol=0, atol=5e-6)


def test_a_run_without_a_state_tells_when_it_ended():
    quick = model(inflow=[[0, 0], [0.02, 1]], times=[0.02], motion="transient")
    assert 0 <= failure(quick, {"E": 20.0, "nu": 0.3, "V_in": 300.0}).evidence["time"] < 0.02
    creep = creeping([1, 60], material="saint_venant_kirchhoff", tolerance=1e-2)
    assert 1 < failure(creep, ONE | {"E": 140.0}).evidence["time"] < 60
