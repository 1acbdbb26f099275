"""The Cauchy stress against the laws written out in space, for a homogeneous deformation."""

import ngsolve as ng
import numpy as np
import pytest
from verification.validation.energies import FURTHER

from strandline.models.biofilm.cell import FlowCell
from strandline.models.biofilm.channel import Channel
from strandline.models.biofilm.geometry import MESHES
from strandline.models.biofilm.materials import LAWS
from strandline.models.biofilm.outline import Outline
from strandline.models.biofilm.subdivision import Partition

E, NU = 400.0, 0.3
LAME, SHEAR = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))
GRADIENT = np.array([[0.1, 0.25], [-0.05, -0.15]])


def saint_venant_kirchhoff(F: np.ndarray) -> tuple[np.ndarray, float]:
    """Return S and pₛ = λ tr E."""
    strain = 0.5 * (F.T @ F - np.eye(3))
    pressure = LAME * np.trace(strain)
    return 2 * SHEAR * strain + pressure * np.eye(3), pressure


def neo_hookean(F: np.ndarray) -> tuple[np.ndarray, float]:
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


@pytest.mark.parametrize("written_out", [saint_venant_kirchhoff, neo_hookean, mooney_rivlin, yeoh])
def test_stress_of_a_homogeneous_deformation(written_out) -> None:
    F = np.eye(3)
    F[:2, :2] += GRADIENT
    S, pressure = written_out(F)
    expected = F @ S @ F.T / np.linalg.det(F)
    cell = FlowCell(
        Outline().interface(),
        MESHES["coarse"],
        channel=Channel(),
        partition=Partition(),
        law=LAWS[written_out.__name__],
    )
    cell.system.set_material([E / 10], [NU], *([value] for value in FURTHER[written_out.__name__]))
    (a, b), (c, d) = GRADIENT.tolist()
    cell.system.state.components[2].Set(ng.CF((a * ng.x + b * ng.y, c * ng.x + d * ng.y)))
    cell.system.state.components[3].Set(ng.CF(pressure / 10), definedon=cell.mesh.Materials("solid"))
    fields = cell.fields()
    solid = fields.stress[fields.cell_part > 0]
    components = [expected[0, 0], expected[1, 1], expected[0, 1], expected[2, 2]]
    np.testing.assert_allclose(solid, np.tile(components, (len(solid), 1)), rtol=1e-9, atol=1e-9 * E)
    assert not fields.stress[fields.cell_part == 0].any()
    assert abs(expected[0, 1] - S[0, 1]) > 0.01 * E  # another stress would show
