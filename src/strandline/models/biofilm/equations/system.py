"""The discrete coupled system: unknowns, residual, Jacobian.

Velocity P2 and pressure P1 on the fluid, displacement P2 on the whole domain, solid pressure P1 on the solid. The
fluid's momentum balance is tested with w + φ on the interface, so the traction there is the consistent residual. The
rows of displacement unknowns *inside* the fluid are replaced by those of the mesh motion (`row selection`): this is
exactly conservative, and no penalty pollutes the interface.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Protocol, runtime_checkable

import ngsolve as ng
import numpy as np
from jaxtyping import Bool, Float, Int
from ngsolve import la
from scipy.sparse import csr_array

from strandline.foundations import ForwardModelError
from strandline.models.biofilm.equations import forms
from strandline.models.biofilm.equations.fluid_elements import Entries, FluidElements, Numbers, Values
from strandline.models.biofilm.equations.memory import Memory
from strandline.models.biofilm.equations.solid_elements import SolidElements
from strandline.models.biofilm.linear import Factorisation, Vector
from strandline.models.biofilm.materials import LAWS, IsotropicLaw, Law, further_parameters, typical_value


@runtime_checkable
class Term(Protocol):
    """What some elements add, as a function of an NGSolve function with the coefficients of all unknowns."""

    def places(self) -> tuple[Numbers, Numbers]:
        """Return row and column of each entry that `jacobian` has returned; those of one place add up."""

    def residual(self, state: Any) -> Values: ...

    def jacobian(self, state: Any) -> Entries: ...


class SymbolicPart:
    """A form that NGSolve differentiates."""

    def __init__(self, form: Any) -> None:
        self.form = form

    def places(self) -> tuple[Numbers, Numbers]:
        return _places(self.form.mat)

    def residual(self, state: Any) -> Values:
        result = state.vec.CreateVector()
        self.form.Apply(state.vec, result)
        return np.array(result.FV().NumPy())

    def jacobian(self, state: Any) -> Entries:
        self.form.AssembleLinearization(state.vec)
        return np.array(self.form.mat.AsVector().FV().NumPy())


def product(places: tuple[Numbers, Numbers], entries: Entries, vector: Values) -> Values:
    """Return the product of the square matrix with these entries and a vector."""
    rows, columns = places
    return np.bincount(rows, weights=entries * vector[columns], minlength=len(vector))


class Pattern:
    """Where the entries of the parts go in the sparse matrix of the free unknowns.

    `used` tells which entries at the `places` are not zero; if only a load is zero now, other entries hold its place.
    The rows that are constant come from `constant` (constant, dof), not from the parts. `free` numbers the unknowns.
    """

    def __init__(
        self,
        places: tuple[Numbers, Numbers],
        used: Bool[np.ndarray, " entry"],
        constant: csr_array,
        is_constant: Bool[np.ndarray, " dof"],
        free: Int[np.ndarray, " unknown"],
    ) -> None:
        number, count = np.full(len(is_constant), -1), len(free)
        number[free] = np.arange(count)

        def codes(at: tuple[Numbers, Numbers], kept: Bool[np.ndarray, " entry"]) -> Numbers:
            """Return a number for each place in the reduced matrix; -1 for entries that are left out."""
            row, column = (number[part] for part in at)
            return np.where(kept & (row >= 0) & (column >= 0), row * count + column, -1)

        fixed = constant.tocoo()
        of_parts = codes(places, ~is_constant[places[0]])
        of_constants = codes((np.flatnonzero(is_constant)[fixed.row], fixed.col), fixed.data != 0.0)
        distinct = np.unique(np.concatenate([of_parts[used], of_constants]))
        distinct = distinct[distinct >= 0]
        rows, columns = (part.tolist() for part in np.divmod(distinct, count))
        self.matrix = la.SparseMatrixd.CreateFromCOO(rows, columns, [1.0] * len(distinct), count, count)
        found = np.minimum(np.searchsorted(distinct, of_parts), len(distinct) - 1)
        self.slots: Int[np.ndarray, " entry"] = np.where(distinct[found] == of_parts, found, len(distinct))
        """The place of each entry among the matrix's values, behind the last if left out."""
        kept, self.constants = of_constants >= 0, np.zeros(len(distinct))
        self.constants[np.searchsorted(distinct, of_constants[kept])] = fixed.data[kept]

    def fill(self, entries: Entries) -> Any:
        """Write the sums of the entries and the constant rows into the matrix; return it."""
        sums = np.bincount(self.slots, weights=entries, minlength=len(self.constants) + 1)
        self.matrix.AsVector().FV().NumPy()[:] = sums[:-1] + self.constants
        return self.matrix


def _places(matrix: Any) -> tuple[Numbers, Numbers]:
    """Return row and column of each entry of an NGSolve matrix."""
    _, columns, pointers = matrix.CSR()
    counts: Int[np.ndarray, " row"] = np.diff(np.array(pointers, dtype=np.int64))
    return np.repeat(np.arange(len(counts)), counts), np.array(columns, dtype=np.int64)


@dataclass(frozen=True)
class BoundaryNames:
    """Regular expressions for boundaries: of zero or prescribed velocity (`no_slip`, `inlet`), of zero displacement.

    On others the vertical velocity is zero, or the vertical displacement (sliding).
    """

    no_slip: str
    inlet: str
    fixed: str
    vertical_velocity_zero: str = ""
    sliding: str = ""


class CoupledSystem:
    """Residual and Jacobian of the coupled problem on a mesh with a region ``fluid`` and one or more solid ones.

    The boundary between them is called ``interface``. Each region of the solid has its own Young's modulus, Poisson's
    ratio and further parameters; the solid may have a `memory` of its stresses. Viscosity, density and the force per
    volume of the undeformed solid are scaled.
    """

    ORDER: ClassVar[int] = 2
    """Order of velocity and displacement; pressures have one less."""

    def __init__(
        self,
        mesh: Any,
        boundaries: BoundaryNames,
        *,
        viscosity: float,
        density: float,
        law: Law = LAWS["saint_venant_kirchhoff"],
        solids: tuple[str, ...] = ("solid",),
        body_force: tuple[float, float] = (0.0, 0.0),
        loads: Sequence[forms.FluidLoad] = (),
        remembers: bool = False,
    ) -> None:
        self.mesh, self.solids = mesh, solids
        self.memory = Memory(mesh) if remembers else None
        starts = (1.0, 0.25, *map(typical_value, further_parameters(law)))
        self.material = tuple(tuple(ng.Parameter(start) for _ in solids) for start in starts)
        self.space = _spaces(mesh, boundaries, self.ORDER, solids)
        self.state = ng.GridFunction(self.space)
        self._residual = self.state.vec.CreateVector()
        self.law, self.body_force = law, body_force
        self._derivatives: dict[Any, Any] = {}
        self._profile = ng.GridFunction(ng.H1(mesh, order=1, definedon="|".join(solids)))
        self._profile.vec[:] = 1.0
        self.viscosity, self.density, self.loads = ng.Parameter(viscosity), ng.Parameter(density), tuple(loads)
        self._fluid: FluidElements | None = None
        self.solid: SolidElements | None = None
        self._parts = self._elements()
        self._entries: Float[np.ndarray, " entry"]
        self.free: Int[np.ndarray, " unknown"] = np.flatnonzero([bool(b) for b in self.space.FreeDofs()])
        self.is_motion: Bool[np.ndarray, " dof"] = _motion_rows(self)
        self._motion = forms.motion_matrix(self.space, self.is_motion)

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

    @property
    def has_profile(self) -> bool:
        return self.solid is not None and self.solid.profile is not None

    def set_profile(self, factors: Float[np.ndarray, " vertex"] | None) -> None:
        """Set the factor of Young's modulus at each vertex of the solid, linear between them; None: 1."""
        assert self.solid is not None
        self._profile.vec[:] = 1.0
        if factors is not None:
            self._profile.vec.FV().NumPy()[self.solid.vertices] = factors
        self.solid.profile = factors

    def of_region(self, k: int) -> tuple[Any, ...]:
        """Return the material parameters of solid region k: Young's modulus, Poisson's ratio, further ones."""
        young, *others = (parameters[k] for parameters in self.material)
        return (young if self.solid is None else young * self._profile, *others)

    @cached_property
    def elastic_stress(self) -> Any:
        """Second Piola–Kirchhoff stress of the law at the current state, scaled; an NGSolve function."""
        _, _, d, *pressures = self.state.components
        stresses = (self.law(d, p, *self.of_region(k)).second_piola for k, p in enumerate(pressures))
        return self.mesh.MaterialCF(dict(zip(self.solids, stresses, strict=True)))

    def set_unknowns(self, x: Vector) -> None:
        self.values[self.free] = x

    def residual(self, x: Vector) -> Vector:
        """Return the residual of the coupled system at `x`; a run in which it is not finite fails."""
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
        """Return the factorised Jacobian at `x`; one that is kept for long has its own analysis, see `linear`."""
        self.set_unknowns(x)
        pattern = self._pattern
        return Factorisation(pattern.fill(self._assemble()), len(self.free), own_analysis=own_analysis)

    def by_profile(self, tests: Float[np.ndarray, "test unknown"]) -> Float[np.ndarray, "test vertex"]:
        """Return the derivatives of tests · residual by the factors of `set_profile`, at the current state."""
        assert self.solid is not None
        rows = np.zeros((len(tests), len(self.values)))
        rows[:, self.free] = tests
        return self.solid.by_profile(self.state, rows)

    def by_parameter(self, parameter: Any) -> Vector:
        """Return the derivative of the residual by one of `material`, `viscosity`, `density`, or the parameter of a
        load."""
        if parameter not in self._derivatives:
            form = forms.solid_form(self, derivative_by=parameter)
            forms.add_loads(form, self, derivative_by=parameter)
            self._derivatives[parameter] = form
        self._derivatives[parameter].Apply(self.state.vec, self._residual)
        result = np.array(self._residual.FV().NumPy())
        if self._fluid is not None and any(parameter is one for one in (self.viscosity, self.density)):
            result += self._fluid.by_parameter(self.state, parameter)
        result[self.is_motion] = 0.0
        return np.asarray(result[self.free])

    def by_prescribed(self, direction: Float[np.ndarray, " dof"]) -> Vector:
        """Return the derivative of the residual when prescribed values change along `direction`, as last assembled."""
        result = product(self._places, self._entries, direction)
        result[self.is_motion] = self._motion @ direction
        return np.asarray(result[self.free])

    def _elements(self) -> tuple[Term, ...]:
        """Return what adds up to the residual: elements of their own as far as there are any, all else by NGSolve."""
        self.solid = solid = _solid_elements(self)
        form = ng.BilinearForm(self.space) if solid else forms.solid_form(self)
        forms.add_loads(form, self)
        if "fluid" in self.mesh.GetMaterials():
            fluid = {"viscosity": self.viscosity, "density": self.density}
            self._fluid = FluidElements(self.space, *fluid_cells(self.mesh), **fluid)
        symbolic = [SymbolicPart(form)] if form.integrators else []
        return (*symbolic, *(part for part in (solid, self._fluid) if part is not None))

    def _assemble(self) -> Float[np.ndarray, " entry"]:
        self._entries = np.concatenate([part.jacobian(self.state) for part in self._parts])
        return self._entries

    @cached_property
    def _places(self) -> tuple[Numbers, Numbers]:
        """Row and column of each entry that `_assemble` returns."""
        places = [part.places() for part in self._parts]
        return np.concatenate([rows for rows, _ in places]), np.concatenate([columns for _, columns in places])

    @cached_property
    def _pattern(self) -> Pattern:
        """Structural nonzeros of the reduced Jacobian, found at a random state."""
        kept = np.array(self.values)
        material = [[p.Get() for p in group] for group in self.material]
        profile = None if self.solid is None else self.solid.profile
        if profile is not None:
            self.set_profile(None)
        self.values[:] = np.random.default_rng(0).uniform(-1e-3, 1e-3, len(kept))
        generic = (1.0, 0.23, *map(typical_value, further_parameters(self.law)))
        self.set_material(*([value] * len(self.solids) for value in generic))
        used = self._assemble() != 0.0
        pattern = Pattern(self._places, used, self._motion, self.is_motion, self.free)
        self.values[:] = kept
        self.set_material(*material)
        if profile is not None:
            self.set_profile(profile)
        return pattern


def _spaces(mesh: Any, names: BoundaryNames, order: int, solids: tuple[str, ...]) -> Any:
    """Return v × p × d × pₛ: the solid's pressure jumps between regions of different stiffness, so each has its own."""
    stuck, level = "|".join([names.no_slip, names.inlet, "interface"]), names.vertical_velocity_zero
    velocity = ng.VectorH1(mesh, order=order, definedon="fluid", dirichlet=stuck, dirichlety=level)
    displacement = ng.VectorH1(mesh, order=order, dirichlet=names.fixed, dirichlety=names.sliding)
    pressure, *solid_pressures = (ng.H1(mesh, order=order - 1, definedon=region) for region in ("fluid", *solids))
    return ng.FESpace([velocity, pressure, displacement, *solid_pressures])


def _cells(mesh: Any, region: str) -> Int[np.ndarray, " element"]:
    return np.array([element.nr for element in mesh.Elements(ng.VOL) if element.mat == region], dtype=int)


def fluid_cells(mesh: Any) -> tuple[Int[np.ndarray, " element"], Int[np.ndarray, " marked"]]:
    """Return the numbers of the fluid's elements, and which of these touch the interface."""
    cells = _cells(mesh, "fluid")
    beside = np.array([bool(bit) for bit in forms.fluid_beside_interface(mesh)], dtype=bool)
    return cells, np.flatnonzero(beside[cells])


def _solid_elements(system: CoupledSystem) -> SolidElements | None:
    """Return the solid's elements, unless there are none, or its stress is no function of the present strain alone."""
    if not isinstance(system.law, IsotropicLaw) or system.memory is not None or not system.solids:
        return None
    cells = [_cells(system.mesh, region) for region in system.solids]
    return SolidElements(system.space, system.law, cells, material=system.material, body_force=system.body_force)


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
