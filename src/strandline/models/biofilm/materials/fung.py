"""A law of Fung's type: it stiffens exponentially with strain."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from strandline.models.biofilm.materials.isotropic import IsotropicLaw, Number, exp
from strandline.models.protocol import ModelInput

__all__ = ["Fung"]


@dataclass(frozen=True)
class Fung(IsotropicLaw):
    """Energy μ/(2b) (exp(b Q) - 1) + ½ λ (ln J)² with Q = I₁ - 3 - 2 ln J.

    `exponent` is b; 0 is the neo-Hookean law. Source: Fung, Biomechanics: Mechanical Properties of Living Tissues
    (1993), in the isotropic form of Demiray, J. Biomech. 5 (1972) 309; Q in place of I₁ - 3 keeps the
    compressible solid free of stress at rest.
    """

    parameters: ClassVar[tuple[ModelInput, ...]] = (
        ModelInput("exponent", "1", 0.0, np.inf, True, False, "exponent b of Fung's law"),
    )

    def coefficients(
        self, invariant: Number, log_volume: Number, pressure: Number, shear: Number, /, exponent: Number
    ) -> tuple[Number, Number, Number]:
        """Return those of S = μ exp(b Q) (I - C⁻¹) + pₛ C⁻¹."""
        stiffness = shear * exp(exponent * (invariant - 3 - 2 * log_volume))
        return stiffness, 0.0, pressure - stiffness
