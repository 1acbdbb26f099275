"""Material laws: stresses written out, limits, derivatives, laws of third parties, the results of earlier versions."""

from pathlib import Path

import ngsolve as ng
import numpy as np
import pytest
from tests.unit.models.biofilm.cells import (
    INPUTS,
    coarse,
    importable,
    moved,
    rough,
    rough_cell,
    sensitivity_error,
)
from verification.validation.energies import ENERGIES, FURTHER
from verification.validation.generality import law_inputs

from strandline.models.biofilm.materials import LAWS
from strandline.models.biofilm.materials.isotropic import Jet, flaw

EARLIER = (
    ({}, 400.0, [[0.045971970618460034, 0.014044939224772457], [0.030339027110091177, -0.006895709740690925]]),
    ({}, 270.0, [[0.06928335391643548, 0.018338161773347295], [0.044889174008244215, -0.011514735697337297]]),
    (
        {"material": "neo_hookean"},
        400.0,
        [[0.04674938375738169, 0.016808254025071634], [0.03172664578316531, -0.006363314447001334]],
    ),
    (
        {"channel": {"inlet": "right", "outlet": "traction_free"}},
        400.0,
        [[-0.030506441510156468, -0.005288268547500585], [-0.03985506553083962, 0.006367603196248184]],
    ),
)
"""Options, E, and displacements of two nodes by revision 2 of the model before it had other laws, fluids or inflows."""
OWN = """
from dataclasses import dataclass
from typing import ClassVar
from strandline.models.biofilm.materials import LAWS
from strandline.models.protocol import ModelInput

@dataclass(frozen=True)
class Softer:
    parameters: ClassVar = (ModelInput("modulus", "Pa", 0.0, 1e9, meaning="Young's modulus that is taken away"),)

    def __call__(self, d, solid_pressure, young, poisson, /, modulus):
        return LAWS["neo_hookean"](d, solid_pressure, young - modulus, poisson)

def plain(d, solid_pressure, young, poisson):
    return LAWS["neo_hookean"](d, solid_pressure, young, poisson)
"""
E, NU = 400.0, 0.3
LAME, SHEAR = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))
GRADIENT = np.array([[0.1, 0.25], [-0.05, -0.15]])


@pytest.mark.parametrize(("options", "E", "expected"), EARLIER)
def test_results_are_those_of_earlier_versions(options, E, expected):
    """In mm, but for the quadrature of the fluid, which has changed since."""
    found = moved(coarse(**options), {"E": E, "nu": 0.3, "V_in": 100.0})[[20, 45]]
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize(("law", "nu"), [("saint_venant_kirchhoff", 0.3), ("yeoh", 0.49), ("fung", -0.4)])
def test_sensitivities_by_each_parameter_of_a_law(law, nu):
    model, inputs = rough(material=law), law_inputs(law) | {"nu": nu}
    assert [item.name for item in model.inputs] == list(inputs)
    assert sensitivity_error(model, inputs) < 1e-6


def test_a_law_whose_further_parameters_are_zero_is_neo_hookean():
    """Coefficients with their derivatives."""
    measures = (*Jet.variables(3.4, 0.1, 0.7), 2.0)
    expected = [Jet.of(one) for one in LAWS["neo_hookean"].coefficients(*measures)]
    for name in ("mooney_rivlin", "yeoh", "fung"):
        found = [Jet.of(one) for one in LAWS[name].coefficients(*measures, *np.zeros(len(FURTHER[name])))]
        for ours, theirs in zip(found, expected, strict=True):
            np.testing.assert_allclose([ours.value, *ours.slopes], [theirs.value, *theirs.slopes], rtol=1e-15)


def test_a_law_of_a_third_party(tmp_path: Path, monkeypatch):
    own = importable(tmp_path, monkeypatch, "our_laws", OWN)
    found = rough(material=f"{own}:Softer", sensitivities=True)(
        {"E": 500.0, "nu": 0.3, "modulus": 100.0, "V_in": 100.0}
    )
    expected = rough(material="neo_hookean", sensitivities=True)(INPUTS)
    np.testing.assert_allclose(found.interface.points, expected.interface.points, atol=1e-12)
    slopes = found.sensitivities[""]
    np.testing.assert_allclose(slopes["modulus"], -expected.sensitivities[""]["E"], atol=1e-12)
    same = rough(material=f"{own}:plain")(INPUTS).interface.points
    np.testing.assert_allclose(same, expected.interface.points, atol=1e-12)


def test_own_laws_are_right_at_rest_and_have_their_energies():
    assert list(ENERGIES) == list(FURTHER) == list(LAWS)
    assert [flaw(law) for law in LAWS.values()] == [None] * len(LAWS)


def saint_venant_kirchhoff(F: np.ndarray) -> tuple[np.ndarray, float]:
    """Return S and pₛ = λ tr E."""
    strain = 0.5 * (F.T @ F - np.eye(3))
    pressure = LAME * np.trace(strain)
    return 2 * SHEAR * strain + pressure * np.eye(3), pressure


def neo_hookean_law(F: np.ndarray) -> tuple[np.ndarray, float]:
    """Return S and pₛ = λ ln J."""
    inverse, pressure = np.linalg.inv(F.T @ F), LAME * np.log(np.linalg.det(F))
    return SHEAR * (np.eye(3) - inverse) + pressure * inverse, pressure


def mooney_rivlin(F: np.ndarray) -> tuple[np.ndarray, float]:
    """Return S = 2 dW/dC and pₛ = λ ln J."""
    C, inverse, log = F.T @ F, np.linalg.inv(F.T @ F), np.log(np.linalg.det(F))
    (share,) = FURTHER["mooney_rivlin"]
    c2 = 0.5 * SHEAR * share
    c1 = 0.5 * SHEAR - c2
    first = 2 * (c1 + c2 * np.trace(C)) * np.eye(3) - 2 * c2 * C
    return first - (2 * (c1 + 2 * c2) + 4 * c2 * log - LAME * log) * inverse, LAME * log


def yeoh(F: np.ndarray) -> tuple[np.ndarray, float]:
    """Return S = μ (1 + 2 c₂/c₁ Q + 3 c₃/c₁ Q²) (I - C⁻¹) + pₛ C⁻¹ and pₛ = λ ln J."""
    C, inverse, log = F.T @ F, np.linalg.inv(F.T @ F), np.log(np.linalg.det(F))
    second, third = FURTHER["yeoh"]
    Q = np.trace(C) - 3 - 2 * log
    return SHEAR * (1 + 2 * second * Q + 3 * third * Q**2) * (np.eye(3) - inverse) + LAME * log * inverse, LAME * log


def fung(F: np.ndarray) -> tuple[np.ndarray, float]:
    """Return S = μ exp(b Q) (I - C⁻¹) + pₛ C⁻¹ and pₛ = λ ln J."""
    C, inverse, log = F.T @ F, np.linalg.inv(F.T @ F), np.log(np.linalg.det(F))
    (exponent,) = FURTHER["fung"]
    stiffness = SHEAR * np.exp(exponent * (np.trace(C) - 3 - 2 * log))
    return stiffness * (np.eye(3) - inverse) + LAME * log * inverse, LAME * log


@pytest.mark.parametrize("written_out", [saint_venant_kirchhoff, neo_hookean_law, mooney_rivlin, yeoh, fung])
def test_stress_of_a_homogeneous_deformation(written_out) -> None:
    """The Cauchy stress against the laws written out in space."""
    F, law = np.eye(3), written_out.__name__.removesuffix("_law")
    F[:2, :2] += GRADIENT
    S, pressure = written_out(F)
    expected = F @ S @ F.T / np.linalg.det(F)
    cell = rough_cell(law)
    cell.system.set_material([E / 10], [NU], *([value] for value in FURTHER[law]))
    (a, b), (c, d) = GRADIENT.tolist()
    cell.system.state.components[2].Set(ng.CF((a * ng.x + b * ng.y, c * ng.x + d * ng.y)))
    cell.system.state.components[3].Set(ng.CF(pressure / 10), definedon=cell.mesh.Materials("solid"))
    fields = cell.fields()
    solid = fields.stress[fields.cell_part > 0]
    components = [expected[0, 0], expected[1, 1], expected[0, 1], expected[2, 2]]
    np.testing.assert_allclose(solid, np.tile(components, (len(solid), 1)), rtol=1e-9, atol=1e-9 * E)
    assert not fields.stress[fields.cell_part == 0].any()
    assert abs(expected[0, 1] - S[0, 1]) > 0.01 * E  # another stress would show
