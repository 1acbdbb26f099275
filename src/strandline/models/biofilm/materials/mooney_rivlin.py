"""Mooney and Rivlin's law."""

from dataclasses import dataclass
from typing import ClassVar

from ngsolve import Id, Trace

from strandline.models.biofilm.materials.law import Form, MixedStress, Strains, shear_modulus
from strandline.models.protocol import ModelInput

__all__ = ["MooneyRivlin"]


@dataclass(frozen=True)
class MooneyRivlin:
    """Energy c₁ (I₁ - 3) + c₂ (I₂ - 3) - 2 (c₁ + 2c₂) ln J - 2 c₂ (ln J)² + ½ λ (ln J)².

    With c₁ + c₂ = μ/2, E and ν are those of small strains; `share` is c₂ / (c₁ + c₂). A share of 0 is the neo-Hookean
    law. Source: Holzapfel, Nonlinear Solid Mechanics (2000), section 6.5; the term -2 c₂ (ln J)², which
    vanishes at ν = ½, keeps λ that of small strains.
    """

    parameters: ClassVar[tuple[ModelInput, ...]] = (
        ModelInput("share", "1", 0.0, 1.0, meaning="share of the second invariant, c2 / (c1 + c2)"),
    )

    def __call__(self, d: Form, solid_pressure: Form, young: Form, poisson: Form, /, share: Form) -> MixedStress:
        """Return S = 2 (c₁ + c₂ I₁) I - 2 c₂ C - 2 (c₁ + 2c₂ + 2c₂ ln J) C⁻¹ + pₛ C⁻¹ with pₛ = λ ln J."""
        strains, mu = Strains(d), shear_modulus(young, poisson)
        C, log_volume = strains.right_cauchy_green, strains.log_volume
        in_plane = (Trace(C) * Id(2) - C) - strains.inverse * (1 + 2 * log_volume)
        stress = strains.isotropic(mu, solid_pressure) + mu * share * in_plane
        across = solid_pressure + mu * share * (Trace(C) - 2 - 2 * log_volume)
        return MixedStress(stress, strains.volume_constraint(solid_pressure, young, poisson), across)
