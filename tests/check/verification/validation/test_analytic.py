"""Closed forms and balances of `analytic.py`, each with an error planted that it must notice."""

import numpy as np
import pytest
from verification.validation.energies import FURTHER
from verification.validation.tables import observed_orders

from strandline.models.biofilm.materials import LAWS, MixedStress
from verification.validation import analytic

RATIOS = (-0.9, 0.0, 0.3, 0.5)


@pytest.mark.parametrize("kind", ["uniaxial", "shear"])
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("poisson", RATIOS)
def test_homogeneous_states_are_exact(kind, law, poisson):
    displacement, stress = analytic.block_error(kind, law, poisson)
    assert displacement < 1e-10
    assert stress < 1e-10


def test_a_wrong_law_is_noticed(monkeypatch):
    neo_hookean = LAWS["neo_hookean"]

    def stiffer(d, solid_pressure, young, poisson):
        right = neo_hookean(d, solid_pressure, young, poisson)
        return MixedStress(1.001 * right.second_piola, right.constraint)

    monkeypatch.setitem(LAWS, "neo_hookean", stiffer)
    assert max(analytic.block_error("shear", "neo_hookean", 0.3)) > 1e-5


@pytest.mark.parametrize("F", [np.array([[1.2, 0.3], [-0.1, 0.9]]), np.array([[0.8, -0.2], [0.25, 1.1]])])
@pytest.mark.parametrize("poisson", [-0.5, 0.3])
def test_stresses_of_the_closed_forms_are_derivatives_of_the_energies(F, poisson):
    """P = dW/dF by central differences, with the energies from the right Cauchy–Green tensor in three dimensions."""
    mu, lame = 0.5 * analytic.YOUNG / (1 + poisson), analytic._lame(poisson)

    def invariants(F):
        C = np.eye(3)
        C[:2, :2] = F.T @ F
        return np.trace(C), 0.5 * (np.trace(C) ** 2 - np.trace(C @ C)), np.log(np.linalg.det(F))

    def saint_venant_kirchhoff(F):
        E = 0.5 * (F.T @ F - np.eye(2))
        return mu * np.sum(E * E) + 0.5 * lame * np.trace(E) ** 2

    def neo_hookean(F):
        I1, _, log = invariants(F)
        return 0.5 * mu * (I1 - 3 - 2 * log) + 0.5 * lame * log**2

    def mooney_rivlin(F):
        I1, I2, log = invariants(F)
        (share,) = FURTHER["mooney_rivlin"]
        second = mu * share * (0.5 * (I2 - I1) - log - log**2)
        return neo_hookean(F) + second

    def yeoh(F):
        I1, _, log = invariants(F)
        Q = I1 - 3 - 2 * log
        return 0.5 * mu * np.polyval([*FURTHER["yeoh"][::-1], 1.0, 0.0], Q) + 0.5 * lame * log**2

    def fung(F):
        I1, _, log = invariants(F)
        (b,) = FURTHER["fung"]
        return 0.5 * mu * np.expm1(b * (I1 - 3 - 2 * log)) / b + 0.5 * lame * log**2

    for energy in (saint_venant_kirchhoff, neo_hookean, mooney_rivlin, yeoh, fung):
        difference = np.zeros((2, 2))
        for i, j in np.ndindex(2, 2):
            step = np.zeros((2, 2))
            step[i, j] = 1e-5
            difference[i, j] = (energy(F + step) - energy(F - step)) / 2e-5
        law = energy.__name__
        pressure = lame * analytic._volume_change(law, F)
        np.testing.assert_allclose(analytic.first_piola(law, F, pressure, poisson), difference, atol=1e-8)


@pytest.mark.parametrize("law", LAWS)
def test_manufactured_solution_converges_at_the_orders_of_the_elements(law):
    sizes = (0.16, 0.08)
    errors = np.array(analytic.manufactured_errors(law, 0.3, sizes))
    displacement, pressure = (observed_orders(sizes, errors[:, k])[-1] for k in range(2))
    assert displacement > 2.8
    assert pressure > 1.8


def test_poiseuille_flow_is_exact():
    assert max(analytic.poiseuille_error()) < 1e-12


def test_poiseuille_flow_above_a_layer_too_stiff_to_move():
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
