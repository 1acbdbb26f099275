"""The compressible neo-Hookean law."""

from dataclasses import dataclass

from strandline.models.biofilm.materials.isotropic import IsotropicLaw, Number

__all__ = ["NeoHookean"]


@dataclass(frozen=True)
class NeoHookean(IsotropicLaw):
    """Energy ½ μ (I₁ - 3 - 2 ln J) + ½ λ (ln J)².

    Source: Holzapfel, Nonlinear Solid Mechanics (2000), section 6.5.
    """

    def coefficients(
        self, invariant: Number, log_volume: Number, pressure: Number, shear: Number, /
    ) -> tuple[Number, Number, Number]:
        """Return those of S = μ (I - C⁻¹) + pₛ C⁻¹."""
        return shear, 0.0, pressure - shear
