"""The Cauchy stress of the solid, σ = J⁻¹ F S Fᵀ (Holzapfel, Nonlinear Solid Mechanics, 2000, Eq. 3.66)."""

from typing import Any

import ngsolve as ng
import numpy as np
from jaxtyping import Float, Int

from strandline.models.biofilm.distortion import on_elements
from strandline.models.biofilm.materials import Law, deformation_gradient
from strandline.models.biofilm.system import CoupledSystem

__all__ = ["cauchy_stress", "stress_at_nodes"]

Form = Any  # an NGSolve coefficient function


def cauchy_stress(law: Law, d: Form, solid_pressure: Form, *parameters: Form) -> Form:
    """Return (σxx, σyy, σxy, σzz) in plane strain, where F is 1 out of the plane; `parameters` begin with E and ν."""
    F = deformation_gradient(d)
    J = ng.Det(F)
    mixed = law(d, solid_pressure, *parameters)
    stress = F * mixed.second_piola * F.trans / J
    across = solid_pressure if mixed.out_of_plane is None else mixed.out_of_plane
    return ng.CF((stress[0, 0], stress[1, 1], stress[0, 1], across / J))


def stress_at_nodes(system: CoupledSystem, part: Int[np.ndarray, " element"]) -> Float[np.ndarray, "element 6 4"]:
    """Return the scaled stress at the six P2 nodes of each element, as `cauchy_stress` orders it; 0 in the fluid.

    Args:
        system: Coupled system at the state of interest.
        part: Number of the solid's part, from 1, for each element (element,); 0 in the fluid.
    """
    displacement = system.state.components[2]
    result = np.zeros((len(part), 6, 4))
    for k in range(len(system.solids)):
        stress = cauchy_stress(system.law, displacement, system.state.components[3 + k], *system.of_region(k))
        result[part == k + 1] = on_elements(system.mesh, stress)[part == k + 1]
    return result
