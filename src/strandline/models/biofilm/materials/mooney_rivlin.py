"""Mooney and Rivlin's law."""

from dataclasses import dataclass
from typing import ClassVar

from strandline.models.biofilm.materials.isotropic import IsotropicLaw, Number
from strandline.models.protocol import ModelInput

__all__ = ["MooneyRivlin"]


@dataclass(frozen=True)
class MooneyRivlin(IsotropicLaw):
    """Energy c₁ (I₁ - 3) + c₂ (I₂ - 3) - 2 (c₁ + 2c₂) ln J - 2 c₂ (ln J)² + ½ λ (ln J)².

    With c₁ + c₂ = μ/2, E and ν are those of small strains; `share` is c₂ / (c₁ + c₂). A share of 0 is the neo-Hookean
    law. Source: Holzapfel, Nonlinear Solid Mechanics (2000), section 6.5; the term -2 c₂ (ln J)², which
    vanishes at ν = ½, keeps λ that of small strains.
    """

    parameters: ClassVar[tuple[ModelInput, ...]] = (
        ModelInput("share", "1", 0.0, 1.0, meaning="share of the second invariant, c2 / (c1 + c2)"),
    )

    def coefficients(
        self, invariant: Number, log_volume: Number, pressure: Number, shear: Number, /, share: Number
    ) -> tuple[Number, Number, Number]:
        """Return those of S = 2 (c₁ + c₂ I₁) I - 2 c₂ C - 2 (c₁ + 2c₂ + 2c₂ ln J) C⁻¹ + pₛ C⁻¹."""
        second = shear * share
        return shear + second * (invariant - 1), -second, pressure - shear - second * (1 + 2 * log_volume)
