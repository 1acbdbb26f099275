"""The biofilm with a field as its modulus."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from tests.unit.models.biofilm.cells import INPUTS, coarse, rough

from strandline.foundations import InvalidInput
from strandline.models import WithFields, declared_inputs, fingerprint, require_inputs, vjp
from strandline.models.protocol import SolvesOnFinerMesh
from strandline.parameters import GaussianField, LogUniform, Support


def test_equal_values_are_the_scalar_to_the_bit_and_derivatives_sum_up():
    model = rough(sensitivities=True)
    points = len(model.field_support("E").points)
    scalar, field = model(INPUTS), model(INPUTS | {"E": np.full(points, INPUTS["E"])})
    assert field.interface.points.tobytes() == scalar.interface.points.tobytes()
    by_field = field.sensitivities[""]["E"]
    assert by_field.shape == (*scalar.interface.points.shape, points)
    np.testing.assert_allclose(by_field.sum(axis=-1), scalar.sensitivities[""]["E"], rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(field.sensitivities[""]["nu"], scalar.sensitivities[""]["nu"], rtol=1e-9, atol=1e-12)


def test_derivatives_by_coefficients_are_those_of_differences():
    plain = rough()
    field = GaussianField(400.0, 0.4, LogUniform(0.2, 0.5), modes=4).on("E", plain.field_support("E"), "Pa")
    model = WithFields(plain, (field,))
    at = {name: INPUTS[name] for name in ("nu", "V_in")} | dict(
        zip(field.names, [0.5, -1.0, 0.8, 0.3, 0.3], strict=True)
    )
    assert {item.name for item in declared_inputs(model)} == {*at}
    assert not isinstance(model, SolvesOnFinerMesh)
    slopes = model.with_option("sensitivities", True)(at, Path()).sensitivities[""]
    for name, value in at.items():
        h = 1e-3 * max(1.0, abs(value))
        ends = [model({**at, name: value + by}, Path()).interface.points for by in (h, -h)]
        difference = (ends[0] - ends[1]) / (2 * h)
        np.testing.assert_allclose(slopes[name], difference, atol=2e-5 * np.abs(difference).max())


def test_it_takes_a_field_as_the_modulus_of_one_part_at_its_own_points():
    plain = rough()
    with pytest.raises(InvalidInput, match="expected E, of a model without partition"):
        plain.field_support("nu")
    line = GaussianField(400.0, 0.4, 0.2, modes=4).on("E", Support.interval(0.0, 1.0, 20), "Pa")
    with pytest.raises(InvalidInput, match="points of the field E: got 20 points; expected the"):
        WithFields(plain, (line,))
    own = replace(line, support=plain.field_support("E"))
    with pytest.raises(InvalidInput, match="without partition, branches and anchors"):
        WithFields(rough(anchors={"E": [400, 700], "nu": 0.3, "V_in": 100}), (own,))
    with pytest.raises(InvalidInput, match="field that the model lacks: got E; expected one of E1"):
        WithFields(coarse(partition="three_parts"), (own,))


SCALARS = {name: INPUTS[name] for name in ("nu", "V_in")}
ONE = {"inflow": [[0, 0], [1, 1]], "times": {"half": 0.5, "full": 1}}
VARIANTS = {
    "one flow": ({}, SCALARS),
    "two flows": ({"inflow_rates": {"slow": 50, "fast": 100}, "fluid": {"viscosity": "unknown"}}, {"viscosity": 1e-3}),
    "two drops": ({"inflow": "pressure", "pressure_drops": {"low": 5, "high": 9}}, {}),
    "quasi-static": ({"course": ONE}, SCALARS),
}


@pytest.mark.parametrize("name", VARIANTS)
def test_adjoint_derivatives_are_differences_and_one_back_solve_gives_a_gradient(name):
    """In a direction in which all inputs change; extrapolated to sixth order as `sensitivity_error`."""
    options, others = VARIANTS[name]
    model, random = rough(**options), np.random.default_rng(2)
    points = model.field_support("E").points
    at = {"nu": 0.3, **others, "E": 400.0 * np.exp(0.3 * np.sin(7.0 * points[:, 0]))}
    change = {of: value * (random.uniform(0.2, 0.6, len(points)) if of == "E" else 0.3) for of, value in at.items()}
    factors = {one: random.standard_normal(model.undeformed().points.shape) for one in model.conditions}
    found, gradient = vjp(model, at, factors, Path())
    slopes = replace(model, sensitivities=True)(at).sensitivities
    assert set(slopes) == set(model.conditions)
    for one in model.conditions:
        assert set(slopes[one]) == set(at)
        exact = sum(slopes[one][of] @ by if of == "E" else slopes[one][of] * by for of, by in change.items())

        def difference(h, one=one):
            ends = [model({of: at[of] + sign * h * change[of] for of in at}).interfaces[one].points for sign in (1, -1)]
            return (ends[0] - ends[1]) / (2 * h)

        d = [difference(h) for h in (4e-2, 2e-2, 1e-2)]
        once = [(4 * fine - coarse) / 3 for coarse, fine in pairwise(d)]
        assert np.abs((16 * once[1] - once[0]) / 15 - exact).max() < 1e-6 * np.abs(exact).max()
    for of in at:
        expected = sum(np.tensordot(factors[one], slopes[one][of], 2) for one in model.conditions)
        np.testing.assert_allclose(gradient[of], expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    model(at | {"nu": 0.1})
    again = found.vjp(factors)
    assert all(np.array_equal(again[of], gradient[of]) for of in at)


def test_a_gradient_by_scalars_that_a_function_of_the_interface_asks_for():
    model = rough(partition="three_parts")
    at = {item.name: INPUTS[item.name.rstrip("123")] for item in model.inputs}
    rest = model.undeformed().points
    found, gradient = vjp(model, at, lambda run: {"": 2 * (run.interface.points - rest)}, Path())
    slopes = replace(model, sensitivities=True)(at).sensitivities[""]
    assert set(gradient) == set(at)
    for name, slope in slopes.items():
        np.testing.assert_allclose(gradient[name], (2 * (found.interface.points - rest) * slope).sum(), rtol=1e-9)
    assert vjp(model, at, {}, Path())[1] == dict.fromkeys(at, 0.0)
    for wrong, words in (
        ({"fast": rest}, "factors of fast: got no such condition"),
        ({"": rest[1:]}, r"got \(7, 2\); expected \(8,"),
    ):
        with pytest.raises(InvalidInput, match=words):
            vjp(model, at, wrong, Path())


def test_what_depends_on_the_past_has_no_derivatives_and_a_solid_that_creeps_no_field():
    points = len(rough().field_support("E").points)
    rise = {"inflow": [[0, 0.5], [1, 0.8]], "times": {"early": 0.01}, "motion": "transient"}
    moving, creeping = rough(course=rise), rough(course=ONE, branches=1)
    for model in (moving, creeping):
        with pytest.raises(InvalidInput, match="derivatives of the model: got this model offers none; expected a vjp"):
            vjp(model, INPUTS, {}, Path())
    scalar, field = (moving(INPUTS | {"E": E}) for E in (400.0, np.full(points, 400.0)))
    assert field.vjp is None
    np.testing.assert_allclose(field.interfaces["early"].points, scalar.interfaces["early"].points, atol=1e-12)
    with pytest.raises(InvalidInput, match="field of the biofilm model: got E with branches; expected E, of a"):
        creeping(SCALARS | {"E": np.full(points, 400.0), "ratio": 1.0, "tau": 1.0})


def test_several_flows_take_a_field_and_are_the_single_runs():
    several, plain = rough(inflow_rates={"slow": 50, "fast": 100}), rough()
    field = GaussianField(400.0, 0.4, 0.3, modes=3).on("E", plain.field_support("E"), "Pa")
    one, other = WithFields(several, (field,)), WithFields(plain, (field,))
    at = dict(zip(field.names, [0.5, -1.0, 0.8], strict=True)) | {"nu": 0.3}
    require_inputs({item.name: item.unit for item in one.inputs}, (), one)
    with pytest.raises(InvalidInput, match="input that the model lacks: got V_in; expected one of E_1, E_2, E_3, nu"):
        require_inputs({"V_in": "mm^2/s"}, (), one)
    found = one(at, Path())
    for name, rate in several.inflow_rates:
        alone = other(at | {"V_in": rate}, Path())
        assert found.interfaces[name].points.tobytes() == alone.interface.points.tobytes()
    turned = rough(inflow_rates={"fast": 100, "slow": 50})(at | {"E": field.values(np.array([0.5, -1.0, 0.8]))})
    assert turned.interfaces["slow"].points.tobytes() == found.interfaces["slow"].points.tobytes()
    faster = WithFields(rough(inflow_rates={"slow": 50, "fast": 101}), (field,))
    assert len({fingerprint(model) for model in (one, other, faster)}) == 3
