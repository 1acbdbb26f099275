"""Weak forms of quasi-steady fluid–structure interaction on the undeformed mesh, as small functions of fields.

Notation, with d the displacement (ALE extension in the fluid): F = I + ∇d, J = det F; pₛ solid pressure. Test functions
w (momentum), φ (displacement), qₛ. All quantities are scaled: lengths by 1 mm, velocities by U = 100 mm/s, stresses by
ρU² (see `model`). The balances of the fluid are in `fluid_elements`, the solid's laws in `materials`. The forms of a
whole `CoupledSystem` are at the end.
"""

from dataclasses import dataclass
from typing import Any

import ngsolve as ng
import numpy as np
from jaxtyping import Bool
from ngsolve import Det, Grad, InnerProduct, Trace, specialcf
from scipy.sparse import csr_array

from strandline.models.biofilm.materials import deformation_gradient

Form = Any  # an NGSolve coefficient function


@dataclass(frozen=True, eq=False)
class FluidLoad:
    """A force per volume, and a pressure (a form) on boundaries by a pattern, in proportion to an NGSolve parameter."""

    parameter: Any
    force: tuple[float, float] = (0.0, 0.0)
    pressure: Any = None
    boundary: str = ""


def body_force(d: Form, test: Form, force: Form) -> Form:
    """Return -J f · test, f being the force per volume of the deformed fluid."""
    return -Det(deformation_gradient(d)) * InnerProduct(force, test)


def outer_pressure(test: Form, pressure: Form) -> Form:
    """Return p n · test, for a pressure from outside on an undeformed boundary with the outward normal n."""
    return pressure * InnerProduct(specialcf.normal(2), test)


def solid_stress_power(d: Form, second_piola: Form, test: Form) -> Form:
    """Return F S : ∇test."""
    return InnerProduct(deformation_gradient(d) * second_piola, Grad(test))


def mesh_motion(d: Form, test: Form) -> Form:
    """Return the linear elasticity that extends the displacement into the fluid, stiff (1/h²) in small elements."""
    strain, virtual = (0.5 * (Grad(u) + Grad(u).trans) for u in (d, test))
    return (2 * InnerProduct(strain, virtual) + Trace(strain) * Trace(virtual)) / specialcf.mesh_size**2


def solid_form(system: Any, *, derivative_by: Any = None) -> Any:
    """Return momentum and constitutive constraint of the solid, or their derivative with respect to a parameter.

    They are separate forms: the cost of a Jacobian grows with the product of a form's trial and test components and
    with its length, so the sum as a single form takes twice as long to assemble.
    """
    (_, _, d, *solid_pressures), (_, _, phi, *solid_tests) = system.space.TnT()
    form = ng.BilinearForm(system.space)
    same_quadrature = ng.Parameter(0.0)  # without d and pₛ in a derivative NGSolve would take fewer points than before
    for k, region in enumerate(system.solids):
        mixed = system.law(d, solid_pressures[k], *system.of_region(k))
        stress = mixed.second_piola if system.memory is None else system.memory.stress(mixed.second_piola)
        momentum = solid_stress_power(d, stress, phi) - ng.InnerProduct(ng.CF(system.body_force), phi)
        dx = ng.dx(region, bonus_intorder=2) if system.memory is None else system.memory.dx(region)
        for term, test in ((momentum, phi[0]), (solid_tests[k] * mixed.constraint, solid_tests[k])):
            if derivative_by is None:
                form += term.Compile() * dx
            elif any(parameters[k] is derivative_by for parameters in system.material):
                rest = same_quadrature * (d[0] + solid_pressures[k]) * test
                form += (term.Diff(derivative_by) + rest).Compile() * dx
    return form


def add_loads(form: Any, system: Any, *, derivative_by: Any = None) -> None:
    """Add the further loads on the fluid, tested with w + φ on the interface, or a derivative of them."""
    d, (w, _, phi, *_) = system.space.TrialFunction()[2], system.space.TestFunction()
    beside_interface = {"definedonelements": fluid_beside_interface(system.mesh)}
    for load in system.loads:
        for test, where in ((w, {}), (phi, beside_interface)) if any(load.force) else ():
            loaded = load.parameter * body_force(d, test, ng.CF(load.force))
            force = _or_derivative(loaded, load.parameter, derivative_by)
            if force is not None:
                form += force.Compile() * ng.dx("fluid", bonus_intorder=2, **where)
        if load.boundary:
            outer = _or_derivative(load.parameter * outer_pressure(w, load.pressure), load.parameter, derivative_by)
            if outer is not None:
                form += outer.Compile() * ng.ds(load.boundary)


def _or_derivative(term: Any, parameter: Any, by: Any) -> Any:
    """Return a term that is proportional to `parameter`, or its derivative; None if it does not depend on `by`."""
    if by is None:
        return term
    return term.Diff(by) if by is parameter else None


def motion_matrix(space: Any, rows: Bool[np.ndarray, " dof"]) -> csr_array:
    """Return the rows of the matrix of the mesh motion that determine the displacement inside the fluid."""
    d, phi = space.TrialFunction()[2], space.TestFunction()[2]
    form = ng.BilinearForm(space)
    form += mesh_motion(d, phi) * ng.dx("fluid")
    form.Assemble()
    values, columns, starts = (np.array(part) for part in form.mat.CSR())
    chosen: csr_array = csr_array((values, columns, starts), shape=(space.ndof, space.ndof))[rows]
    chosen.eliminate_zeros()
    return chosen


def fluid_beside_interface(mesh: Any) -> Any:
    """Mark the fluid elements that touch the interface: φ|Γ is nonzero only there."""
    on_interface = {v.nr for e in mesh.Elements(ng.BND) if e.mat == "interface" for v in e.vertices}
    marked = ng.BitArray(mesh.ne)
    marked.Clear()
    for element in mesh.Elements(ng.VOL):
        if element.mat == "fluid" and any(v.nr in on_interface for v in element.vertices):
            marked.Set(element.nr)
    return marked
