"""The biofilm model: the study's specimen, limits, determinism, failures, fields, files for ParaView."""

import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest
from tests.unit.models.biofilm.cells import INPUTS, SOLID, coarse, failure, largest, moved, rough

from strandline.models.biofilm.cells.fields import write_vtu
from strandline.models.biofilm.linear import linear_solver
from strandline.models.biofilm.mesh.outline import Outline
from strandline.models.biofilm.model import Biofilm

REFERENCE = Outline().interface()


@pytest.fixture(scope="module")
def model() -> Biofilm:
    return Biofilm(mesh="coarse")


def test_it_bends_downstream_as_in_the_study_with_the_same_bits_whatever_ran_before(model):
    result = model(INPUTS)
    shift = result.interface.points - REFERENCE.points
    np.testing.assert_allclose(largest(shift), 0.0495, rtol=0.015)
    np.testing.assert_allclose(result.diagnostics["max_displacement"], largest(shift))
    assert shift[:, 0].mean() > 0.01
    np.testing.assert_allclose(shift[[0, -1]], 0.0, atol=1e-15)
    assert 0 < result.diagnostics["min_J_solid"] < 1
    assert result.diagnostics["mkl"] == (linear_solver() == "pardiso")
    model({"E": 250.0, "nu": -0.5, "V_in": 40.0})
    failure(model, INPUTS | {"E": 60.0})
    assert model(INPUTS).interface.points.tobytes() == result.interface.points.tobytes()


def test_no_flow_no_displacement_and_for_small_ones_compliance_counts(model):
    np.testing.assert_array_equal(model({**INPUTS, "V_in": 0.0}).interface.points, REFERENCE.points)
    shapes = [moved(model, {**INPUTS, "E": E}) for E in (1e6, 2e6)]
    np.testing.assert_allclose(shapes[0], 2 * shapes[1], rtol=2e-3, atol=1e-9)


def test_too_soft_a_sample_is_a_typed_failure_at_bounded_cost(model):
    found = failure(model, INPUTS | {"E": 100.0})
    assert found.kind in {"limit_point", "continuation_stalled"}
    assert found.evidence["jacobians"] <= model.failure_budget + 1
    whole = failure(Biofilm(mesh="coarse", failure_budget=0), INPUTS | {"E": 100.0})
    assert whole.kind == "limit_point"
    assert whole.evidence["jacobians"] > Biofilm().failure_budget


def test_fields_for_pictures_are_consistent_with_the_interface(model):
    fields = model.fields(INPUTS)
    assert largest(fields.displacement) >= model(INPUTS).diagnostics["max_displacement"] - 1e-12
    assert fields.triangles.max() < len(fields.points)
    inlet = np.isclose(fields.points[:, 0], 0.0)
    y = fields.points[inlet, 1]
    np.testing.assert_allclose(fields.velocity[inlet, 0], 600 * y * (1 - y), atol=1e-9)


def test_vtu_holds_the_fields_and_numbers_the_parts_by_their_markers(tmp_path):
    meshio, model = pytest.importorskip("meshio"), coarse(partition="three_parts")
    fields = model.fields({item.name: INPUTS[item.name.rstrip("123")] for item in model.inputs})
    collection = write_vtu(fields, tmp_path / "out")
    files = [item.get("file") for item in ElementTree.parse(collection).iter("DataSet")]
    undeformed, deformed = (meshio.read(collection.parent / name) for name in files)
    moved = deformed.points - undeformed.points
    np.testing.assert_allclose(deformed.points[:, :2], fields.points)
    np.testing.assert_allclose(moved, deformed.point_data["displacement [mm]"], atol=1e-15)
    np.testing.assert_allclose(deformed.point_data["pressure [Pa]"], fields.pressure)
    np.testing.assert_array_equal(deformed.cells_dict["triangle"], fields.triangles)
    part, stress = (deformed.cell_data[name][0] for name in ("part", "Cauchy stress [Pa]"))
    np.testing.assert_allclose(stress[:, [0, 1, 3, 2]], fields.stress)
    assert not stress[:, 4:].any()
    assert set(part.tolist()) == {0, 1, 2, 3}
    centres = undeformed.points[undeformed.cells_dict["triangle"]].mean(axis=1)[:, :2]
    for number, marker in enumerate(model.partition.markers, 1):
        assert part[np.argmin(np.linalg.norm(centres - marker, axis=1))] == number


@pytest.mark.parametrize(
    ("options", "drive", "more"),
    [
        ({"inflow_rates": {"slow": 40, "fast": 80}, "fluid": {"viscosity": "unknown"}}, "V_in", {"viscosity": 1e-3}),
        ({"inflow": "pressure", "pressure_drops": {"slow": 4, "fast": 8}}, "p_drop", {}),
    ],
)
def test_several_loads_are_the_single_runs_with_their_fields_sensitivities_and_mesh_error(options, drive, more):
    several, inputs = rough(sensitivities=True, **options), SOLID | more
    assert [item.name for item in several.inputs] == list(inputs)
    result, single = several(inputs), replace(several, inflow_rates=(), pressure_drops=())
    for name, load in several.inflow_rates or several.pressure_drops:
        alone = single(inputs | {drive: load})
        np.testing.assert_array_equal(result.interfaces[name].points, alone.interface.points)
        assert set(result.sensitivities[name]) == set(inputs)
        np.testing.assert_array_equal(result.sensitivities[name]["E"], alone.sensitivities[""]["E"])
    finer, coarse = several.on_finer_mesh(inputs), replace(several, mesh="coarse")(inputs).interfaces
    assert finer.keys() == coarse.keys()
    assert all(np.array_equal(finer[name].points, coarse[name].points) for name in coarse)
    peaks = {name: np.abs(several.fields(inputs, name).velocity).max() for name in several.conditions}
    assert 1.5 < peaks["fast"] / peaks["slow"] < 2.2
    assert np.abs(several.fields(inputs).velocity).max() == pytest.approx(peaks["fast"], rel=1e-9)
