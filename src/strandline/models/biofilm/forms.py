"""Weak forms of quasi-steady fluid–structure interaction on the undeformed mesh, as small functions of fields.

Notation, with d the displacement (ALE extension in the fluid): F = I + ∇d, J = det F, C = cof F = J F⁻ᵀ; v, p fluid
velocity and pressure; pₛ solid pressure. Test functions w (momentum), q (continuity), φ (displacement), qₛ. All
quantities are scaled: lengths by 1 mm, velocities by U = 100 mm/s, stresses by ρU² (see `model`).

Sources: Hron and Turek, A monolithic FEM/multigrid solver for an ALE formulation of fluid–structure interaction (2006),
for the ALE form. The solid's laws are in `materials`.
"""

from typing import Any

from ngsolve import Cof, Det, Grad, InnerProduct, Inv, Trace, specialcf

from strandline.models.biofilm.materials import deformation_gradient

__all__ = [
    "body_force",
    "continuity",
    "convection",
    "mesh_motion",
    "outer_pressure",
    "pressure",
    "solid_stress_power",
    "viscous",
]

Form = Any  # an NGSolve coefficient function


def viscous(v: Form, d: Form, test: Form, viscosity: Form) -> Form:
    """Return μ (∇v F⁻¹ + F⁻ᵀ ∇vᵀ) C : ∇test, the friction of a Newtonian fluid."""
    F = deformation_gradient(d)
    gradient = Grad(v) * Inv(F)
    return viscosity * InnerProduct((gradient + gradient.trans) * Cof(F), Grad(test))


def pressure(p: Form, d: Form, test: Form) -> Form:
    """Return -p C : ∇test."""
    return -p * InnerProduct(Cof(deformation_gradient(d)), Grad(test))


def convection(v: Form, d: Form, test: Form, density: Form) -> Form:
    """Return ρ (∇v Cᵀ v) · test."""
    return density * InnerProduct(Grad(v) * (Cof(deformation_gradient(d)).trans * v), test)


def body_force(d: Form, test: Form, force: Form) -> Form:
    """Return -J f · test, f being the force per volume of the deformed fluid."""
    return -Det(deformation_gradient(d)) * InnerProduct(force, test)


def outer_pressure(test: Form, pressure: Form) -> Form:
    """Return p n · test, for a pressure from outside on an undeformed boundary with the outward normal n."""
    return pressure * InnerProduct(specialcf.normal(2), test)


def continuity(v: Form, d: Form, q: Form) -> Form:
    """Return q C : ∇v."""
    return q * InnerProduct(Cof(deformation_gradient(d)), Grad(v))


def solid_stress_power(d: Form, second_piola: Form, test: Form) -> Form:
    """Return F S : ∇test."""
    return InnerProduct(deformation_gradient(d) * second_piola, Grad(test))


def mesh_motion(d: Form, test: Form) -> Form:
    """Return the linear elasticity that extends the displacement into the fluid, stiff (1/h²) in small elements."""
    strain, virtual = (0.5 * (Grad(u) + Grad(u).trans) for u in (d, test))
    return (2 * InnerProduct(strain, virtual) + Trace(strain) * Trace(virtual)) / specialcf.mesh_size**2
