"""Saint-Venant and Kirchhoff's law: linear in the Green–Lagrange strain; the law of the published study."""

from ngsolve import Id, Trace

from strandline.models.biofilm.materials.law import Form, MixedStress, compliance, green_lagrange

__all__ = ["saint_venant_kirchhoff"]


def saint_venant_kirchhoff(d: Form, solid_pressure: Form, young: Form, poisson: Form) -> MixedStress:
    """Return S = 2 μ E + pₛ I with pₛ = λ tr E, from the energy μ E:E + ½ λ (tr E)².

    Source: Holzapfel, Nonlinear Solid Mechanics (2000), section 6.5.
    """
    strain = green_lagrange(d)
    stress = young / (1 + poisson) * strain + solid_pressure * Id(2)
    return MixedStress(stress, poisson * Trace(strain) - compliance(young, poisson) * solid_pressure)
