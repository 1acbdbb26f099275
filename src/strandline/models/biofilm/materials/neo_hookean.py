"""The compressible neo-Hookean law."""

from ngsolve import Det, Id, Inv, log

from strandline.models.biofilm.materials.law import Form, MixedStress, compliance, deformation_gradient

__all__ = ["neo_hookean"]


def neo_hookean(d: Form, solid_pressure: Form, young: Form, poisson: Form) -> MixedStress:
    """Return S = μ (I - C⁻¹) + pₛ C⁻¹ with pₛ = λ ln J, from the energy ½ μ (tr C - 3 - 2 ln J) + ½ λ (ln J)².

    Source: Holzapfel, Nonlinear Solid Mechanics (2000), section 6.5.
    """
    F = deformation_gradient(d)
    inverse = Inv(F.trans * F)
    stress = 0.5 * young / (1 + poisson) * (Id(2) - inverse) + solid_pressure * inverse
    return MixedStress(stress, poisson * log(Det(F)) - compliance(young, poisson) * solid_pressure)
