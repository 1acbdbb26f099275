"""The fluid's balances as weak forms that NGSolve differentiates: what the product's elements are compared with.

Notation of `strandline.models.biofilm.equations.forms`; v, p are the fluid's velocity and pressure, C = cof F = J F⁻ᵀ,
q is the test function of continuity. Source: Hron and Turek, A monolithic FEM/multigrid solver for an ALE formulation
of fluid–structure interaction (2006).
"""

from typing import Any

import ngsolve as ng
from ngsolve import Cof, Grad, InnerProduct, Inv

from strandline.models.biofilm.equations.forms import Form, add_loads, fluid_beside_interface, solid_form
from strandline.models.biofilm.equations.system import CoupledSystem, SymbolicPart
from strandline.models.biofilm.materials import deformation_gradient


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


def continuity(v: Form, d: Form, q: Form) -> Form:
    """Return q C : ∇v."""
    return q * InnerProduct(Cof(deformation_gradient(d)), Grad(v))


def add_fluid(form: Any, system: Any) -> None:
    """Add momentum and continuity of the fluid, the former tested with w + φ on the interface.

    Every term is a separate form: the cost of a Jacobian grows with the product of a form's trial and test components
    and with its length, so the sum as a single form takes twice as long to assemble.
    """
    (v, p, d, *_), (w, q, phi, *_) = system.space.TnT()
    beside_interface = {"definedonelements": fluid_beside_interface(system.mesh)}
    for test, where in ((w, {}), (phi, beside_interface)):
        for term, bonus in (
            (viscous(v, d, test, system.viscosity), 2),
            (pressure(p, d, test), 0),
            (convection(v, d, test, system.density), 2),
        ):
            form += term.Compile() * ng.dx("fluid", bonus_intorder=bonus, **where)
    form += continuity(v, d, q).Compile() * ng.dx("fluid")


class CubicSystem(CoupledSystem):
    """A `CoupledSystem` of one order more, which has no elements of its own: NGSolve integrates all forms."""

    ORDER = 3

    def _elements(self) -> tuple[SymbolicPart, ...]:
        form = solid_form(self)
        add_loads(form, self)
        if "fluid" in self.mesh.GetMaterials():
            add_fluid(form, self)
        return (SymbolicPart(form),)
