"""Saint-Venant and Kirchhoff's law: linear in the Green–Lagrange strain; the law of the published study."""

from dataclasses import dataclass

from strandline.models.biofilm.materials.isotropic import IsotropicLaw, Number

__all__ = ["SaintVenantKirchhoff"]


@dataclass(frozen=True)
class SaintVenantKirchhoff(IsotropicLaw):
    """Energy μ E:E + ½ λ (tr E)² of the strain E = ½ (C - I).

    Source: Holzapfel, Nonlinear Solid Mechanics (2000), section 6.5.
    """

    def coefficients(
        self, invariant: Number, log_volume: Number, pressure: Number, shear: Number, /
    ) -> tuple[Number, Number, Number]:
        """Return those of S = 2 μ E + pₛ I."""
        return pressure - shear, shear, 0.0

    def volume(self, invariant: Number, log_volume: Number) -> Number:
        """Return tr E."""
        return 0.5 * (invariant - 3)
