"""What verifies the biofilm, at a few points and each with an error planted; `validation` makes the tables."""

import numpy as np
import pytest
from verification.validation import analytic, biofilm_mesh
from verification.validation.biofilm_mesh import flow_cell
from verification.validation.generality import SPECIMENS, sensitivity_errors, specimen
from verification.validation.tables import observed_orders

from strandline.models.biofilm.cells.cell import Setting
from strandline.models.biofilm.materials import LAWS, MixedStress
from strandline.models.biofilm.mesh.geometry import MESHES

CORNERS = [("uniaxial", "saint_venant_kirchhoff", 0.5), ("uniaxial", "neo_hookean", 0.5), ("shear", "yeoh", -0.9)]


def test_homogeneous_states_are_exact_and_a_wrong_law_is_noticed(monkeypatch):
    for case in [*(("shear", law, 0.3) for law in LAWS), *CORNERS]:
        assert max(analytic.block_error(*case)) < 1e-10, case
    neo_hookean = LAWS["neo_hookean"]

    def stiffer(d, solid_pressure, young, poisson):
        right = neo_hookean(d, solid_pressure, young, poisson)
        return MixedStress(1.001 * right.second_piola, right.constraint)

    monkeypatch.setitem(LAWS, "neo_hookean", stiffer)
    assert max(analytic.block_error("shear", "neo_hookean", 0.3)) > 1e-5


@pytest.mark.parametrize("law", ["saint_venant_kirchhoff", "neo_hookean"])
def test_manufactured_solution_converges_at_the_orders_of_the_elements(law):
    sizes = (0.16, 0.08)
    errors = np.array(analytic.manufactured_errors(law, 0.3, sizes))
    displacement, pressure = (observed_orders(sizes, errors[:, k])[-1] for k in range(2))
    assert displacement > 2.8
    assert pressure > 1.8


def test_poiseuille_flow_is_exact_forces_and_mass_balance_and_those_of_an_unfinished_solution_do_not():
    assert max(analytic.poiseuille_error()) < 1e-12
    assert analytic.layer_error() < 1e-8, "above a layer too stiff to move"
    cell = flow_cell(MESHES["coarse"])
    solution = cell.solve(Setting([400.0], [0.3], 100.0))
    assert max(analytic.force_imbalance(cell)) < 1e-8
    assert analytic.mass_imbalance(cell) < 1e-9
    cell.system.set_unknowns(solution.unknowns * (1 + 1e-6 * np.sin(np.arange(len(solution.unknowns)))))
    assert max(analytic.force_imbalance(cell)) > 1e-7
    assert analytic.mass_imbalance(cell) > 1e-9


@pytest.mark.long
@pytest.mark.parametrize("inputs", [SPECIMENS[1], SPECIMENS[-1]], ids=["nearly incompressible", "three parts"])
def test_sensitivities_agree_with_differences(inputs):
    assert max(sensitivity_errors(specimen(inputs, "coarse"), inputs).values()) < 1e-6


def test_sensitivities_with_a_jacobian_from_elsewhere_do_not(monkeypatch):
    """The planted error: the Jacobian of a solution at E half a percent larger."""
    model = specimen(SPECIMENS[0], "coarse")
    cell, _ = model._cell()
    elsewhere = cell.system.factorise(cell.solve(Setting([402.0], [0.3], 100.0)).unknowns)
    exact = cell.sensitivities

    def stale(solution, fluid):
        with monkeypatch.context() as patch:
            patch.setattr(cell.system, "factorise", lambda x: elsewhere)
            return exact(solution, fluid)

    monkeypatch.setattr(cell, "sensitivities", stale)
    assert max(sensitivity_errors(model, SPECIMENS[0]).values()) > 1e-5


def test_extreme_inputs_are_solved():
    laws = ("saint_venant_kirchhoff", "neo_hookean")
    (table,) = biofilm_mesh.extremes(mesh="coarse", laws=laws)
    assert set(table.column("outcome")) == {"solved"}
    moved = dict(zip(((r[0], *r[1:4]) for r in table.rows), table.column("largest displacement, µm"), strict=True))
    for law in laws:
        assert moved[law, 400.0, 0.3, 0.0] == 0.0
        np.testing.assert_allclose(moved[law, 400.0, 0.5, 100.0], moved[law, 400.0, 0.4999999, 100.0], rtol=1e-5)
        assert moved[law, 1e7, 0.3, 100.0] < 0.01
