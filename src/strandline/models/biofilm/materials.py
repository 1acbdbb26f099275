"""Hyperelastic laws in mixed form, plane strain; a new law is one function and one line in `LAWS`.

A law takes the displacement d, the solid pressure pₛ, Young's modulus E and Poisson's ratio ν and returns the second
Piola–Kirchhoff stress and the residual of the constitutive constraint that defines pₛ. The constraint is written so
that it is regular for every ν in (-1, ½], ν = 0 and ν = ½ included. Source: Holzapfel, Nonlinear Solid Mechanics
(2000), sections 6.3–6.6.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ngsolve import Det, Grad, Id, Inv, Trace, log

__all__ = ["LAWS", "Law", "MixedStress", "neo_hookean", "saint_venant_kirchhoff"]

Form = Any  # an NGSolve coefficient function


@dataclass(frozen=True)
class MixedStress:
    """Stress of a law, and the constraint that defines its pressure.

    Args:
        second_piola: Second Piola–Kirchhoff stress S, a 2 × 2 form.
        constraint: Form that vanishes where pₛ is the pressure-like stress of the law.
    """

    second_piola: Form
    constraint: Form


Law = Callable[[Form, Form, Form, Form], MixedStress]


def deformation_gradient(d: Form) -> Form:
    """Return F = I + ∇d."""
    return Id(2) + Grad(d)


def green_lagrange(d: Form) -> Form:
    """Return the strain ½ (FᵀF - I)."""
    F = deformation_gradient(d)
    return 0.5 * (F.trans * F - Id(2))


def saint_venant_kirchhoff(d: Form, solid_pressure: Form, young: Form, poisson: Form) -> MixedStress:
    """Return S = 2 μ E + pₛ I with pₛ = λ tr E, from the energy μ E:E + ½ λ (tr E)²."""
    strain = green_lagrange(d)
    stress = young / (1 + poisson) * strain + solid_pressure * Id(2)
    return MixedStress(stress, poisson * Trace(strain) - _compliance(young, poisson) * solid_pressure)


def neo_hookean(d: Form, solid_pressure: Form, young: Form, poisson: Form) -> MixedStress:
    """Return S = μ (I - C⁻¹) + pₛ C⁻¹ with pₛ = λ ln J, from the energy ½ μ (tr C - 3 - 2 ln J) + ½ λ (ln J)²."""
    F = deformation_gradient(d)
    inverse = Inv(F.trans * F)
    stress = 0.5 * young / (1 + poisson) * (Id(2) - inverse) + solid_pressure * inverse
    return MixedStress(stress, poisson * log(Det(F)) - _compliance(young, poisson) * solid_pressure)


LAWS: dict[str, Law] = {"saint_venant_kirchhoff": saint_venant_kirchhoff, "neo_hookean": neo_hookean}
"""Names in study files → laws."""


def _compliance(young: Form, poisson: Form) -> Form:
    """Return (1+ν)(1-2ν)/E = ν/λ."""
    return (1 + poisson) * (1 - 2 * poisson) / young
