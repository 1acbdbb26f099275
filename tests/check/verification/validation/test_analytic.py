"""Closed forms and balances of `analytic.py`, each with an error planted that it must notice."""

import numpy as np
import pytest
from verification.validation import analytic
from verification.validation.energies import FURTHER
from verification.validation.tables import observed_orders

from strandline.models.biofilm.materials import LAWS, MixedStress

CORNERS = [("uniaxial", "saint_venant_kirchhoff", 0.5), ("uniaxial", "neo_hookean", 0.5), ("shear", "yeoh", -0.9)]


def test_homogeneous_states_are_exact():
    for case in [*(("shear", law, 0.3) for law in LAWS), *CORNERS]:
        assert max(analytic.block_error(*case)) < 1e-10, case


def test_a_wrong_law_is_noticed(monkeypatch):
    neo_hookean = LAWS["neo_hookean"]

    def stiffer(d, solid_pressure, young, poisson):
        right = neo_hookean(d, solid_pressure, young, poisson)
        return MixedStress(1.001 * right.second_piola, right.constraint)

    monkeypatch.setitem(LAWS, "neo_hookean", stiffer)
    assert max(analytic.block_error("shear", "neo_hookean", 0.3)) > 1e-5


def energy_of(law, F, mu, lame):
    """Return the energy from the right Cauchy-Green tensor in three dimensions."""
    C = np.eye(3)
    C[:2, :2] = F.T @ F
    I1, I2, log = np.trace(C), 0.5 * (np.trace(C) ** 2 - np.trace(C @ C)), np.log(np.linalg.det(F))
    if law == "saint_venant_kirchhoff":
        E = 0.5 * (F.T @ F - np.eye(2))
        return mu * np.sum(E * E) + 0.5 * lame * np.trace(E) ** 2
    Q, further = I1 - 3 - 2 * log, FURTHER[law]
    shape = {
        "neo_hookean": lambda: 0.5 * Q,
        "mooney_rivlin": lambda share: 0.5 * Q + share * (0.5 * (I2 - I1) - log - log**2),
        "yeoh": lambda *c: 0.5 * np.polyval([*c[::-1], 1.0, 0.0], Q),
        "fung": lambda b: 0.5 * np.expm1(b * Q) / b,
    }
    return mu * shape[law](*further) + 0.5 * lame * log**2


@pytest.mark.parametrize("poisson", [-0.5, 0.3])
def test_stresses_of_the_closed_forms_are_derivatives_of_the_energies(poisson):
    """P = dW/dF by central differences."""
    mu, lame = 0.5 * analytic.YOUNG / (1 + poisson), analytic._lame(poisson)
    for F in (np.array([[1.2, 0.3], [-0.1, 0.9]]), np.array([[0.8, -0.2], [0.25, 1.1]])):
        for law in LAWS:
            difference = np.zeros((2, 2))
            for place in np.ndindex(2, 2):
                step = np.zeros((2, 2))
                step[place] = 1e-5
                more, less = (energy_of(law, F + sign * step, mu, lame) for sign in (1, -1))
                difference[place] = (more - less) / 2e-5
            pressure = lame * analytic._volume_change(law, F)
            np.testing.assert_allclose(analytic.first_piola(law, F, pressure, poisson), difference, atol=1e-8)


@pytest.mark.parametrize("law", ["saint_venant_kirchhoff", "neo_hookean"])
def test_manufactured_solution_converges_at_the_orders_of_the_elements(law):
    sizes = (0.16, 0.08)
    errors = np.array(analytic.manufactured_errors(law, 0.3, sizes))
    displacement, pressure = (observed_orders(sizes, errors[:, k])[-1] for k in range(2))
    assert displacement > 2.8
    assert pressure > 1.8


def test_poiseuille_flow_is_exact_also_above_a_layer_too_stiff_to_move():
    assert max(analytic.poiseuille_error()) < 1e-12
    assert analytic.layer_error() < 1e-8


def test_forces_and_mass_balance_and_an_unfinished_solution_does_not():
    cell = analytic.default_cell()
    solution = cell.solve([400.0], [0.3], 100.0)
    assert max(analytic.force_imbalance(cell)) < 1e-8
    assert analytic.mass_imbalance(cell) < 1e-9
    disturbed = solution.unknowns * (1 + 1e-6 * np.sin(np.arange(len(solution.unknowns))))
    cell.system.set_unknowns(disturbed)
    assert max(analytic.force_imbalance(cell)) > 1e-7
    assert analytic.mass_imbalance(cell) > 1e-9
