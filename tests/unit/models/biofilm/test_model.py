"""The biofilm model: the study's specimen, limits, determinism, failures, fields."""

from dataclasses import replace

import numpy as np
import pytest
from tests.unit.models.biofilm.cells import INPUTS, SOLID, failure, largest, moved, rough

from strandline.models.biofilm.model import Biofilm
from strandline.models.biofilm.outline import CONTROL_POINTS, NODES, Outline

REFERENCE = Outline().interface()


@pytest.fixture(scope="module")
def model() -> Biofilm:
    return Biofilm(mesh="coarse")


def test_outline_has_the_figures_of_the_study():
    assert len(REFERENCE.points) == NODES == 66
    np.testing.assert_allclose(REFERENCE.lengths.sum(), 1.447, atol=5e-4)
    np.testing.assert_allclose((REFERENCE.lengths**2).mean(), 0.0005, rtol=0.02)
    assert np.ptp(REFERENCE.lengths) < 2e-3 * REFERENCE.lengths.mean()  # chords of equal arcs
    np.testing.assert_array_equal(REFERENCE.points[[0, -1]], np.array(CONTROL_POINTS)[[0, -1]])
    REFERENCE.require_simple()


def test_it_bends_downstream_by_the_displacement_of_the_study(model):
    result = model(INPUTS)
    shift = result.interface.points - REFERENCE.points
    np.testing.assert_allclose(largest(shift), 0.0495, rtol=0.015)
    np.testing.assert_allclose(result.diagnostics["max_displacement"], largest(shift))
    assert shift[:, 0].mean() > 0.01
    np.testing.assert_allclose(shift[[0, -1]], 0.0, atol=1e-15)
    assert 0 < result.diagnostics["min_J_solid"] < 1


def test_same_inputs_same_bits_whatever_ran_before(model):
    first = model(INPUTS).interface.points.tobytes()
    model({"E": 250.0, "nu": -0.5, "V_in": 40.0})
    failure(model, {"E": 60.0, "nu": 0.3, "V_in": 100.0})
    assert model(INPUTS).interface.points.tobytes() == first


def test_no_flow_no_displacement_and_for_small_ones_compliance_counts(model):
    np.testing.assert_array_equal(model({**INPUTS, "V_in": 0.0}).interface.points, REFERENCE.points)
    shapes = [moved(model, {**INPUTS, "E": E}) for E in (1e6, 2e6)]
    np.testing.assert_allclose(shapes[0], 2 * shapes[1], rtol=2e-3, atol=1e-9)


def test_all_poisson_ratios_are_solved_up_to_the_incompressible_limit():
    for law in ("saint_venant_kirchhoff", "neo_hookean"):
        model = rough(material=law)
        found = {nu: model({**INPUTS, "nu": nu}) for nu in (-0.99, -0.9, 0.0, 0.4999, 0.49999, 0.5)}
        for result in found.values():
            assert result.diagnostics["newton_jacobians"] <= 6
            assert result.diagnostics["max_displacement"] > 1e-4
        np.testing.assert_allclose(found[0.49999].interface.points, found[0.5].interface.points, atol=2e-6)


def test_too_soft_a_sample_is_a_typed_failure_at_bounded_cost(model):
    found = failure(model, {"E": 100.0, "nu": 0.3, "V_in": 100.0})
    assert found.kind in {"limit_point", "continuation_stalled"}
    assert found.evidence["jacobians"] <= model.failure_budget + 1
    assert 0 < found.evidence["load_reached"] < 100
    whole = failure(Biofilm(mesh="coarse", failure_budget=0), {"E": 100.0, "nu": 0.3, "V_in": 100.0})
    assert whole.kind == "limit_point"
    assert 50 < whole.evidence["limit_load"] < 70
    assert whole.evidence["jacobians"] > Biofilm().failure_budget


def test_fields_for_pictures_are_consistent_with_the_interface(model):
    fields = model.fields(INPUTS)
    assert largest(fields.displacement) >= model(INPUTS).diagnostics["max_displacement"] - 1e-12
    assert fields.triangles.max() < len(fields.points)
    inlet = np.isclose(fields.points[:, 0], 0.0)
    y = fields.points[inlet, 1]
    np.testing.assert_allclose(fields.velocity[inlet, 0], 600 * y * (1 - y), atol=1e-9)
    corners = fields.points[fields.triangles]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    assert (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] > 0).all()


@pytest.mark.parametrize(
    ("options", "drive", "more"),
    [
        ({"inflow_rates": {"slow": 40, "fast": 80}, "fluid": {"viscosity": "unknown"}}, "V_in", {"viscosity": 1e-3}),
        ({"inflow": "pressure", "pressure_drops": {"slow": 4, "fast": 8}}, "p_drop", {}),
    ],
    ids=["rates", "pressure drops"],
)
def test_several_loads_are_the_single_runs_with_their_fields_and_sensitivities(options, drive, more):
    several, inputs = rough(sensitivities=True, **options), SOLID | more
    assert several.conditions == ("slow", "fast")
    assert [item.name for item in several.inputs] == list(inputs)
    result, single = several(inputs), replace(several, inflow_rates=(), pressure_drops=())
    for name, load in several.inflow_rates or several.pressure_drops:
        alone = single(inputs | {drive: load})
        np.testing.assert_array_equal(result.interfaces[name].points, alone.interface.points)
        assert set(result.sensitivities[name]) == set(inputs)
        np.testing.assert_array_equal(result.sensitivities[name]["E"], alone.sensitivities[""]["E"])
    peaks = {name: np.abs(several.fields(inputs, name).velocity).max() for name in several.conditions}
    assert 1.5 < peaks["fast"] / peaks["slow"] < 2.2
    assert np.abs(several.fields(inputs).velocity).max() == pytest.approx(peaks["fast"], rel=1e-9)
