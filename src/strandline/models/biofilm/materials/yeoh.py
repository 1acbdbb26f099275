"""Yeoh's law: a cubic polynomial in the first invariant."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from strandline.models.biofilm.materials.isotropic import IsotropicLaw, Number
from strandline.models.protocol import ModelInput

__all__ = ["Yeoh"]


@dataclass(frozen=True)
class Yeoh(IsotropicLaw):
    """Energy c₁ Q + c₂ Q² + c₃ Q³ + ½ λ (ln J)² with Q = I₁ - 3 - 2 ln J and c₁ = μ/2.

    `second` is c₂/c₁ and `third` c₃/c₁; with both 0 it is the neo-Hookean law. A negative `second` softens the solid
    at moderate strains; without a `third` that stiffens it again, the solid gives way. Source: Yeoh, Rubber Chem.
    Technol. 66 (1993) 754; Q in place of I₁ - 3 keeps the compressible solid free of stress at rest.
    """

    parameters: ClassVar[tuple[ModelInput, ...]] = (
        ModelInput("second", "1", -np.inf, np.inf, False, False, "ratio of Yeoh's constants, c2 / c1"),
        ModelInput("third", "1", 0.0, np.inf, True, False, "ratio of Yeoh's constants, c3 / c1"),
    )

    def coefficients(
        self, invariant: Number, log_volume: Number, pressure: Number, shear: Number, /, second: Number, third: Number
    ) -> tuple[Number, Number, Number]:
        """Return those of S = μ (1 + 2 c₂/c₁ Q + 3 c₃/c₁ Q²) (I - C⁻¹) + pₛ C⁻¹."""
        Q = invariant - 3 - 2 * log_volume
        stiffness = shear * (1 + 2 * second * Q + 3 * third * Q * Q)
        return stiffness, 0.0, pressure - stiffness
