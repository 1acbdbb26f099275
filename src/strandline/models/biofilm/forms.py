"""Weak forms of quasi-steady fluid–structure interaction on the undeformed mesh, as small functions of fields.

Notation, with d the displacement (ALE extension in the fluid): F = I + ∇d, J = det F, C = cof F = J F⁻ᵀ; v, p fluid
velocity and pressure; pₛ solid pressure. Test functions w (momentum), q (continuity), φ (displacement), qₛ. All
quantities are scaled: lengths by 1 mm, velocities by U = 100 mm/s, stresses by ρU² (see `model`).

Sources: Hron and Turek, A monolithic FEM/multigrid solver for an ALE formulation of fluid–structure interaction (2006),
for the ALE form; Holzapfel, Nonlinear Solid Mechanics (2000), section 6, for the Saint-Venant–Kirchhoff law.
"""

from typing import Any

from ngsolve import Cof, Grad, Id, InnerProduct, Inv, Trace, specialcf

__all__ = [
    "constitutive_constraint",
    "continuity",
    "mesh_motion",
    "momentum",
    "saint_venant_kirchhoff",
    "solid_stress_power",
]

Form = Any  # an NGSolve coefficient function


def deformation_gradient(d: Form) -> Form:
    """Return F = I + ∇d."""
    return Id(2) + Grad(d)


def cauchy_stress(v: Form, p: Form, d: Form, viscosity: float) -> Form:
    """Return σ = -p I + μ (∇v F⁻¹ + F⁻ᵀ ∇vᵀ) of a Newtonian fluid."""
    gradient = Grad(v) * Inv(deformation_gradient(d))
    return -p * Id(2) + viscosity * (gradient + gradient.trans)


def momentum(v: Form, p: Form, d: Form, test: Form, *, viscosity: float, density: float) -> Form:
    """Return σC : ∇test + ρ (∇v Cᵀ v) · test, the steady Navier–Stokes momentum balance in the fluid."""
    C = Cof(deformation_gradient(d))
    stress = InnerProduct(cauchy_stress(v, p, d, viscosity) * C, Grad(test))
    return stress + density * InnerProduct(Grad(v) * (C.trans * v), test)


def continuity(v: Form, d: Form, q: Form) -> Form:
    """Return q C : ∇v."""
    return q * InnerProduct(Cof(deformation_gradient(d)), Grad(v))


def green_lagrange(d: Form) -> Form:
    """Return the strain ½ (FᵀF - I)."""
    F = deformation_gradient(d)
    return 0.5 * (F.trans * F - Id(2))


def saint_venant_kirchhoff(d: Form, solid_pressure: Form, young: Form, poisson: Form) -> Form:
    """Return the second Piola–Kirchhoff stress 2 μₛ E + pₛ I, with μₛ = E / 2(1+ν)."""
    return young / (1 + poisson) * green_lagrange(d) + solid_pressure * Id(2)


def constitutive_constraint(d: Form, solid_pressure: Form, q: Form, young: Form, poisson: Form) -> Form:
    """Return q [ν tr(E) - (1+ν)(1-2ν) pₛ / E]: pₛ = λ tr(E), regular for ν < 0, ν = 0 and ν = ½."""
    compliance = (1 + poisson) * (1 - 2 * poisson) / young
    return q * (poisson * Trace(green_lagrange(d)) - compliance * solid_pressure)


def solid_stress_power(d: Form, second_piola: Form, test: Form) -> Form:
    """Return F S : ∇test."""
    return InnerProduct(deformation_gradient(d) * second_piola, Grad(test))


def mesh_motion(d: Form, test: Form) -> Form:
    """Return the linear elasticity that extends the displacement into the fluid, stiff (1/h²) in small elements."""
    strain, virtual = (0.5 * (Grad(u) + Grad(u).trans) for u in (d, test))
    return (2 * InnerProduct(strain, virtual) + Trace(strain) * Trace(virtual)) / specialcf.mesh_size**2
