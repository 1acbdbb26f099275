"""A law of Fung's type: it stiffens exponentially with strain."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from ngsolve import exp

from strandline.models.biofilm.materials.law import Form, MixedStress, Strains, shear_modulus
from strandline.models.protocol import ModelInput

__all__ = ["Fung"]


@dataclass(frozen=True)
class Fung:
    """Energy μ/(2b) (exp(b Q) - 1) + ½ λ (ln J)² with Q = I₁ - 3 - 2 ln J.

    `exponent` is b; 0 is the neo-Hookean law. Source: Fung, Biomechanics: Mechanical Properties of Living Tissues
    (1993), in the isotropic form of Demiray, J. Biomech. 5 (1972) 309; Q in place of I₁ - 3 keeps the
    compressible solid free of stress at rest.
    """

    parameters: ClassVar[tuple[ModelInput, ...]] = (
        ModelInput("exponent", "1", 0.0, np.inf, True, False, "exponent b of Fung's law"),
    )

    def __call__(self, d: Form, solid_pressure: Form, young: Form, poisson: Form, /, exponent: Form) -> MixedStress:
        """Return S = μ exp(b Q) (I - C⁻¹) + pₛ C⁻¹ with pₛ = λ ln J."""
        strains = Strains(d)
        stiffness = shear_modulus(young, poisson) * exp(exponent * strains.distortion)
        constraint = strains.volume_constraint(solid_pressure, young, poisson)
        return MixedStress(strains.isotropic(stiffness, solid_pressure), constraint)
