"""The discrete coupled system: unknowns, residual, Jacobian.

Velocity P2 and pressure P1 on the fluid, displacement P2 on the whole domain, solid pressure P1 on the solid. The
fluid's momentum balance is tested with w + φ on the interface, so the traction there is the consistent residual. The
rows of displacement unknowns *inside* the fluid are replaced by those of the mesh motion (`row selection`): this is
exactly conservative, and no penalty pollutes the interface.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import ngsolve as ng
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array

from strandline.errors import ForwardModelError
from strandline.models.biofilm import forms
from strandline.models.biofilm.assembly import Part, Pattern, SymbolicPart, product
from strandline.models.biofilm.fluid_elements import FluidElements
from strandline.models.biofilm.linear import Factorisation
from strandline.models.biofilm.materials import LAWS, IsotropicLaw, Law, further_parameters, typical_value
from strandline.models.biofilm.memory import Memory
from strandline.models.biofilm.solid_elements import SolidElements

__all__ = ["BoundaryNames", "CoupledSystem", "FluidLoad", "fluid_cells"]

QUADRATIC = 2
"""Order of velocity and displacement for which fluid and solid have elements of their own, faster than their forms."""

Vector = Float[np.ndarray, " unknown"]


@dataclass(frozen=True)
class BoundaryNames:
    """Regular expressions for the boundaries where a condition holds.

    Args:
        no_slip: Velocity zero.
        inlet: Velocity prescribed.
        fixed: Displacement zero.
        vertical_velocity_zero: Vertical velocity zero.
        sliding: Vertical displacement zero.
    """

    no_slip: str
    inlet: str
    fixed: str
    vertical_velocity_zero: str = ""
    sliding: str = ""


@dataclass(frozen=True, eq=False)
class FluidLoad:
    """A load on the fluid that is proportional to a parameter: a force per volume, and a pressure from outside.

    Args:
        parameter: NGSolve parameter that it is proportional to, scaled.
        force: Force per volume at a parameter of 1, along x and y.
        pressure: External pressure on `boundary` at a parameter of 1, a form.
        boundary: Regular expression for the boundaries under pressure.
    """

    parameter: Any
    force: tuple[float, float] = (0.0, 0.0)
    pressure: Any = None
    boundary: str = ""


class CoupledSystem:
    """Residual and Jacobian of the coupled problem on a mesh with a region ``fluid`` and one or more solid ones.

    Args:
        mesh: NGSolve mesh; the boundary between the regions is called ``interface``.
        boundaries: Names of the boundaries where the conditions hold.
        viscosity: Scaled dynamic viscosity.
        density: Scaled density of the fluid.
        order: Polynomial order of velocity and displacement; pressures have one less.
        law: Law of the solid, from `materials`.
        solids: Names of the solid's regions; each has its own Young's modulus, Poisson's ratio and further parameters.
        body_force: Scaled force per volume of the undeformed solid.
        loads: Further loads on the fluid.
        remembers: Whether the solid has a `memory` of its stresses.
    """

    def __init__(
        self,
        mesh: Any,
        boundaries: BoundaryNames,
        *,
        viscosity: float,
        density: float,
        order: int = 2,
        law: Law = LAWS["saint_venant_kirchhoff"],
        solids: tuple[str, ...] = ("solid",),
        body_force: tuple[float, float] = (0.0, 0.0),
        loads: Sequence[FluidLoad] = (),
        remembers: bool = False,
    ) -> None:
        self.mesh, self.solids = mesh, solids
        self.memory = Memory(mesh) if remembers else None
        starts = (1.0, 0.25, *(typical_value(item) for item in further_parameters(law)))
        self.material = tuple(tuple(ng.Parameter(start) for _ in solids) for start in starts)
        self.space = _spaces(mesh, boundaries, order, solids)
        self.state = ng.GridFunction(self.space)
        self._residual = self.state.vec.CreateVector()
        self.law, self.body_force = law, body_force
        self._derivatives: dict[Any, Any] = {}
        self.viscosity, self.density, self.loads = ng.Parameter(viscosity), ng.Parameter(density), tuple(loads)
        by_elements = order == QUADRATIC
        self._fluid = _fluid_elements(self) if by_elements and "fluid" in mesh.GetMaterials() else None
        self._parts: tuple[Part, ...] = _parts(self, self._fluid, _solid_elements(self) if by_elements else None)
        self._entries: Float[np.ndarray, " entry"]
        self.free: Int[np.ndarray, " unknown"] = np.flatnonzero([bool(b) for b in self.space.FreeDofs()])
        self.is_motion: Bool[np.ndarray, " dof"] = _motion_rows(self)
        self._motion = _motion_matrix(self.space, self.is_motion)

    @property
    def values(self) -> Float[np.ndarray, " dof"]:
        """All coefficients of the state, prescribed ones included; a view."""
        values: Float[np.ndarray, " dof"] = self.state.vec.FV().NumPy()
        return values

    def block(self, component: int) -> Bool[np.ndarray, " unknown"]:
        """Return which unknowns belong to a component: 0 v, 1 p, 2 d, from 3 on the pₛ of each solid region."""
        part = self.space.Range(component)
        return np.asarray((self.free >= part.start) & (self.free < part.stop))

    def set_material(self, *values: Sequence[float]) -> None:
        """Set scaled Young's moduli, Poisson's ratios and further parameters of the law, each by solid region."""
        for parameters, given in zip(self.material, values, strict=True):
            for parameter, value in zip(parameters, given, strict=True):
                parameter.Set(value)

    def of_region(self, k: int) -> tuple[Any, ...]:
        """Return the material parameters of solid region k: Young's modulus, Poisson's ratio, further ones."""
        return tuple(parameters[k] for parameters in self.material)

    @cached_property
    def elastic_stress(self) -> Any:
        """Second Piola–Kirchhoff stress of the law at the current state, scaled; an NGSolve function."""
        _, _, d, *pressures = self.state.components
        stresses = (self.law(d, p, *self.of_region(k)).second_piola for k, p in enumerate(pressures))
        return self.mesh.MaterialCF(dict(zip(self.solids, stresses, strict=True)))

    def set_unknowns(self, x: Vector) -> None:
        """Write the unknowns into the state."""
        self.values[self.free] = x

    def residual(self, x: Vector) -> Vector:
        """Return the residual of the coupled system at `x`.

        Raises:
            ForwardModelError: ``nonfinite_residual``.
        """
        self.set_unknowns(x)
        return np.asarray(self.full_residual()[self.free])

    def full_residual(self) -> Float[np.ndarray, " dof"]:
        """Return the residual of every row at the current state; prescribed rows hold the reactions."""
        result: Float[np.ndarray, " dof"] = np.sum([part.residual(self.state) for part in self._parts], axis=0)
        result[self.is_motion] = self._motion @ self.values
        if not np.isfinite(result).all():
            raise ForwardModelError("nonfinite_residual", "the residual of the coupled system is not finite")
        return result

    def factorise(self, x: Vector, *, own_analysis: bool = False) -> Factorisation:
        """Return the factorised Jacobian at `x`; one that is kept for long has its own analysis, see `linear`.

        Raises:
            ForwardModelError: ``linear_solve``.
        """
        self.set_unknowns(x)
        pattern = self._pattern
        return Factorisation(pattern.fill(self._assemble()), len(self.free), own_analysis=own_analysis)

    def by_parameter(self, parameter: Any) -> Vector:
        """Return the derivative of the residual with respect to one parameter at the current state.

        Args:
            parameter: One of `material`, `viscosity`, `density` or the parameter of a load.
        """
        if parameter not in self._derivatives:
            form = _solid_form(self, derivative_by=parameter)
            _add_loads(form, self, derivative_by=parameter)
            if self._fluid is None:
                _add_fluid(form, self, derivative_by=parameter)
            self._derivatives[parameter] = form
        self._derivatives[parameter].Apply(self.state.vec, self._residual)
        result = np.array(self._residual.FV().NumPy())
        if self._fluid is not None:
            result += self._fluid.by_parameter(self.state, parameter)
        result[self.is_motion] = 0.0
        return np.asarray(result[self.free])

    def by_prescribed(self, direction: Float[np.ndarray, " dof"]) -> Vector:
        """Return the derivative of the residual when prescribed values change along `direction`, as last assembled."""
        result = product(self._places, self._entries, direction)
        result[self.is_motion] = self._motion @ direction
        return np.asarray(result[self.free])

    def _assemble(self) -> Float[np.ndarray, " entry"]:
        self._entries = np.concatenate([part.jacobian(self.state) for part in self._parts])
        return self._entries

    @cached_property
    def _places(self) -> tuple[Int[np.ndarray, " entry"], Int[np.ndarray, " entry"]]:
        """Row and column of each entry that `_assemble` returns."""
        places = [part.places() for part in self._parts]
        return np.concatenate([rows for rows, _ in places]), np.concatenate([columns for _, columns in places])

    @cached_property
    def _pattern(self) -> Pattern:
        """Structural nonzeros of the reduced Jacobian, found at a random state."""
        kept = np.array(self.values)
        material = [[p.Get() for p in group] for group in self.material]
        self.values[:] = np.random.default_rng(0).uniform(-1e-3, 1e-3, len(kept))
        generic = (1.0, 0.23, *(typical_value(item) for item in further_parameters(self.law)))
        self.set_material(*([value] * len(self.solids) for value in generic))
        used = self._assemble() != 0.0
        pattern = Pattern.find(self._places, used, self._motion, self.is_motion, self.free)
        self.values[:] = kept
        self.set_material(*material)
        return pattern


def _spaces(mesh: Any, names: BoundaryNames, order: int, solids: tuple[str, ...]) -> Any:
    """Return v × p × d × pₛ: the solid's pressure jumps between regions of different stiffness, so each has its own."""
    stuck = "|".join([names.no_slip, names.inlet, "interface"])
    velocity = ng.VectorH1(
        mesh, order=order, definedon="fluid", dirichlet=stuck, dirichlety=names.vertical_velocity_zero
    )
    displacement = ng.VectorH1(mesh, order=order, dirichlet=names.fixed, dirichlety=names.sliding)
    pressure, *solid_pressures = (ng.H1(mesh, order=order - 1, definedon=region) for region in ("fluid", *solids))
    return ng.FESpace([velocity, pressure, displacement, *solid_pressures])


def _solid_form(system: CoupledSystem, *, derivative_by: Any = None) -> Any:
    """Return momentum and constitutive constraint of the solid, or their derivative with respect to a parameter.

    They are separate forms, as in `_add_fluid`.
    """
    (_, _, d, *solid_pressures), (_, _, phi, *solid_tests) = system.space.TnT()
    form = ng.BilinearForm(system.space)
    same_quadrature = ng.Parameter(0.0)  # without d and pₛ in a derivative NGSolve would take fewer points than before
    for k, region in enumerate(system.solids):
        mixed = system.law(d, solid_pressures[k], *system.of_region(k))
        stress = mixed.second_piola if system.memory is None else system.memory.stress(mixed.second_piola)
        momentum = forms.solid_stress_power(d, stress, phi) - ng.InnerProduct(ng.CF(system.body_force), phi)
        dx = ng.dx(region, bonus_intorder=2) if system.memory is None else system.memory.dx(region)
        for term, test in ((momentum, phi[0]), (solid_tests[k] * mixed.constraint, solid_tests[k])):
            if derivative_by is None:
                form += term.Compile() * dx
            elif any(parameter is derivative_by for parameter in system.of_region(k)):
                rest = same_quadrature * (d[0] + solid_pressures[k]) * test
                form += (term.Diff(derivative_by) + rest).Compile() * dx
    return form


def _parts(system: CoupledSystem, fluid: FluidElements | None, solid: SolidElements | None) -> tuple[Part, ...]:
    """Return what adds up to the residual: elements of their own as far as there are any, all else by NGSolve."""
    form = ng.BilinearForm(system.space) if solid else _solid_form(system)
    _add_loads(form, system)
    if fluid is None and "fluid" in system.mesh.GetMaterials():
        _add_fluid(form, system)
    symbolic = [SymbolicPart(form)] if form.integrators else []
    return (*symbolic, *(part for part in (solid, fluid) if part is not None))


def fluid_cells(mesh: Any) -> tuple[Int[np.ndarray, " element"], Int[np.ndarray, " marked"]]:
    """Return the numbers of the fluid's elements, and which of these touch the interface."""
    cells = np.array([element.nr for element in mesh.Elements(ng.VOL) if element.mat == "fluid"], dtype=int)
    beside = np.array([bool(bit) for bit in _fluid_beside_interface(mesh)], dtype=bool)
    return cells, np.flatnonzero(beside[cells])


def _fluid_elements(system: CoupledSystem) -> FluidElements:
    cells, loading = fluid_cells(system.mesh)
    return FluidElements(system.space, cells, loading, viscosity=system.viscosity, density=system.density)


def _solid_elements(system: CoupledSystem) -> SolidElements | None:
    """Return the solid's elements, unless there are none, or its stress is no function of the present strain alone."""
    if not isinstance(system.law, IsotropicLaw) or system.memory is not None or not system.solids:
        return None
    cells = [
        np.array([element.nr for element in system.mesh.Elements(ng.VOL) if element.mat == region], dtype=int)
        for region in system.solids
    ]
    return SolidElements(system.space, system.law, cells, material=system.material, body_force=system.body_force)


def _add_fluid(form: Any, system: CoupledSystem, *, derivative_by: Any = None) -> None:
    """Add momentum and continuity of the fluid, the former tested with w + φ on the interface, or a derivative of them.

    Every term is a separate form: the cost of a Jacobian grows with the product of a form's trial and test components
    and with its length, so the sum as a single form takes twice as long to assemble.
    """
    (v, p, d, *_), (w, q, phi, *_) = system.space.TnT()
    beside_interface = {"definedonelements": _fluid_beside_interface(system.mesh)}
    for test, where in ((w, {}), (phi, beside_interface)):
        for term, bonus, parameter in (
            (forms.viscous(v, d, test, system.viscosity), 2, system.viscosity),
            (forms.pressure(p, d, test), 0, None),
            (forms.convection(v, d, test, system.density), 2, system.density),
        ):
            chosen = _or_derivative(term, parameter, derivative_by)
            if chosen is not None:
                form += chosen.Compile() * ng.dx("fluid", bonus_intorder=bonus, **where)
    if derivative_by is None:
        form += forms.continuity(v, d, q).Compile() * ng.dx("fluid")


def _add_loads(form: Any, system: CoupledSystem, *, derivative_by: Any = None) -> None:
    """Add the further loads on the fluid, tested with w + φ on the interface, or a derivative of them."""
    d, (w, _, phi, *_) = system.space.TrialFunction()[2], system.space.TestFunction()
    beside_interface = {"definedonelements": _fluid_beside_interface(system.mesh)}
    for load in system.loads:
        for test, where in ((w, {}), (phi, beside_interface)) if any(load.force) else ():
            force = _or_derivative(_force_of(load, d, test), load.parameter, derivative_by)
            if force is not None:
                form += force.Compile() * ng.dx("fluid", bonus_intorder=2, **where)
        pressure = _or_derivative(_pressure_of(load, w), load.parameter, derivative_by)
        if load.boundary and pressure is not None:
            form += pressure.Compile() * ng.ds(load.boundary)


def _force_of(load: FluidLoad, d: Any, test: Any) -> Any:
    return load.parameter * forms.body_force(d, test, ng.CF(load.force))


def _pressure_of(load: FluidLoad, test: Any) -> Any:
    return load.parameter * forms.outer_pressure(test, 0.0 if load.pressure is None else load.pressure)


def _or_derivative(term: Any, parameter: Any, by: Any) -> Any:
    """Return a term that is proportional to `parameter`, or its derivative; None if it does not depend on `by`."""
    if by is None:
        return term
    return term.Diff(by) if by is parameter else None


def _motion_matrix(space: Any, rows: Bool[np.ndarray, " dof"]) -> csr_array:
    """Return the rows of the matrix of the mesh motion that determine the displacement inside the fluid."""
    d, phi = space.TrialFunction()[2], space.TestFunction()[2]
    form = ng.BilinearForm(space)
    form += forms.mesh_motion(d, phi) * ng.dx("fluid")
    form.Assemble()
    values, columns, starts = (np.array(part) for part in form.mat.CSR())
    chosen: csr_array = csr_array((values, columns, starts), shape=(space.ndof, space.ndof))[rows]
    chosen.eliminate_zeros()
    return chosen


def _fluid_beside_interface(mesh: Any) -> Any:
    """Mark the fluid elements that touch the interface: φ|Γ is nonzero only there."""
    on_interface = {v.nr for e in mesh.Elements(ng.BND) if e.mat == "interface" for v in e.vertices}
    marked = ng.BitArray(mesh.ne)
    marked.Clear()
    for element in mesh.Elements(ng.VOL):
        if element.mat == "fluid" and any(v.nr in on_interface for v in element.vertices):
            marked.Set(element.nr)
    return marked


def _motion_rows(system: CoupledSystem) -> Bool[np.ndarray, " dof"]:
    """Mark the displacement rows inside the fluid: not shared with any solid element, interface included."""
    part = system.space.Range(2)
    rows = np.zeros(system.space.ndof, bool)
    rows[part.start : part.stop] = True
    displacement = system.space.components[2]
    for element in displacement.Elements(ng.VOL):
        if element.mat in system.solids:
            rows[[part.start + dof for dof in element.dofs if dof >= 0]] = False
    return rows
