"""Sensitivities, extreme inputs and meshes of the biofilm at a few points; the tables are made by `validation`."""

import numpy as np
import pytest
from verification.validation import extremes, mesh_on_other_outlines
from verification.validation.biofilm_mesh import box_points, flow_cell
from verification.validation.sensitivities import POINTS, Inputs, partition_of, relative_differences

from strandline.models.biofilm.geometry import MeshSize
from strandline.models.biofilm.sizes import FINER, MESHES

ROUGH = MeshSize(far=0.3, interface=0.09, foot=0.06, grading=0.6)


def test_points_cover_the_box():
    points = box_points(64)
    np.testing.assert_allclose(points.mean(axis=0), [450.0, -0.15], rtol=0.05)
    assert (np.ptp(points, axis=0) > [650.0, 1.2]).all()


@pytest.mark.long
@pytest.mark.parametrize("at", [POINTS[1], POINTS[-1]], ids=["nearly incompressible", "three parts"])
def test_sensitivities_agree_with_differences(at):
    cell = flow_cell(ROUGH, partition=partition_of(len(at.young)), nodes=18)
    assert max(relative_differences(cell, at)) < 1e-6


def test_sensitivities_with_a_jacobian_from_elsewhere_do_not(monkeypatch):
    """The planted error: the Jacobian of a solution at E half a percent larger."""
    cell = flow_cell(ROUGH, nodes=18)
    elsewhere = cell.system.factorise(cell.solve([402.0], [0.3], 100.0).unknowns)
    exact = cell.sensitivities

    def stale(solution):
        with monkeypatch.context() as patch:
            patch.setattr(cell.system, "factorise", lambda x: elsewhere)
            return exact(solution)

    monkeypatch.setattr(cell, "sensitivities", stale)
    assert max(relative_differences(cell, Inputs((400.0,), (0.3,), 100.0))) > 1e-5


def test_extreme_inputs_are_solved():
    laws = ("saint_venant_kirchhoff", "neo_hookean")
    (table,) = extremes.tables(mesh="coarse", laws=laws)
    assert set(table.column("outcome")) == {"solved"}
    moved = dict(zip(((r[0], *r[1:4]) for r in table.rows), table.column("largest displacement, µm"), strict=True))
    for law in laws:
        assert moved[law, 400.0, 0.3, 0.0] == 0.0
        np.testing.assert_allclose(moved[law, 400.0, 0.5, 100.0], moved[law, 400.0, 0.4999999, 100.0], rtol=1e-5)
        assert moved[law, 1e7, 0.3, 100.0] < 0.01
        assert moved[law, 400.0, -0.99, 100.0] < moved[law, 400.0, -0.9, 100.0] < moved[law, 400.0, 0.5, 100.0]
    assert moved[laws[0], 400.0, 0.5, 100.0] != moved[laws[1], 400.0, 0.5, 100.0]


@pytest.mark.long
def test_the_estimate_on_another_outline_is_the_difference_to_the_next_finer_mesh():
    names = [next(iter(mesh_on_other_outlines.CASES))]
    made = mesh_on_other_outlines.table(names, {"coarse": MESHES["coarse"]}, FINER["coarse"])
    found = dict(zip(made.columns, made.rows[0], strict=True))
    assert found["mesh"] == "coarse"
    assert found["estimate by check, µm"] == found["true error, µm"] > 0
    share = 100 * found["true error, µm"] / found["largest displacement, µm"]
    assert found["true error, %"] == pytest.approx(share, rel=1e-12)


def test_the_other_outlines_are_not_the_studys():
    prints = {model.fingerprint for model, _ in mesh_on_other_outlines.CASES.values()}
    assert len(prints) == len(mesh_on_other_outlines.CASES) >= 3
    assert not any(mark.endswith("mesh=default") for mark in prints)
