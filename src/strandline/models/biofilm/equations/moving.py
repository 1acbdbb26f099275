"""The coupled system when its state changes with time: inertia, and a fluid that moves with the interface.

Rates of change are backward differences of second order, with steps of any length: the rate at the new time is the
slope of the parabola through the new value and the last two, BDF2; with one earlier value it is that of the straight
line, backward Euler. Source: Hairer and Wanner, Solving Ordinary Differential Equations II (1996), section V.1, and
Grigorieff, Numer. Math. 42 (1983) 359: stable if no step exceeds 2.41 times the one before.

Inertia, in the notation of `fluid_elements`, with the rate of change a of the velocity at a point of the moving mesh
and the mesh's own velocity u: the fluid's balance gains ∫ ρ (J a - ∇v Cᵀu) · w dξ. Where v is linear in space this
vanishes to rounding on any moving mesh, if a and u are the same differences in time of v and of the displacement: the
geometric conservation law. The solid's balance gains ∫ ρₛ d̈ · φ over the undeformed solid. Source: Donea, Huerta,
Ponthot and Rodríguez-Ferran, Arbitrary Lagrangian–Eulerian Methods, in: Encyclopedia of Computational Mechanics (2004),
equation (16), the form that is not conservative; Lesoinne and Farhat, Comput. Methods Appl. Mech. Eng. 134 (1996) 71,
for the geometric conservation law.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import ngsolve as ng
import numpy as np
from jaxtyping import Float

from strandline.models.biofilm.equations import system
from strandline.models.biofilm.equations.fluid_elements import AtPoints, Entries, FluidElements, Numbers, Values, placed

LARGEST_RATIO = 1.8
"""Largest ratio of a step to the one before, below the bound for stability, 1 + √2."""


@dataclass(frozen=True, eq=False)
class Moment:
    """All coefficients (dof,) of velocity, pressures and displacement at one scaled time, and their rates."""

    time: float
    values: Values
    rates: Values


class Rates:
    """Rates of all coefficients as affine functions of the coefficients at the new time; zero in a steady state."""

    def __init__(self, size: int) -> None:
        self.leading = 0.0
        self._first, self._second = np.zeros(size), np.zeros(size)

    def set(self, time: float, last: Sequence[Moment]) -> None:
        """Prepare the step to `time` from the last moments, newest first: two, or one at a start."""
        used = last[:2]
        self.leading, *weights = differences([time, *(moment.time for moment in used)])
        pairs = list(zip(weights, used, strict=True))
        self._first = np.sum([weight * moment.values for weight, moment in pairs], axis=0)
        self._second = np.sum([weight * moment.rates for weight, moment in pairs], axis=0)

    def rest(self) -> None:
        """Leave out all that changes with time: the equations are those of the steady state."""
        self.leading = 0.0
        self._first, self._second = np.zeros_like(self._first), np.zeros_like(self._second)

    def first(self, values: Values) -> Values:
        return self.leading * values + self._first

    def second(self, values: Values) -> Values:
        """Return the rates of the rates: of a displacement, its acceleration."""
        return self.leading * self.first(values) + self._second


def differences(times: Sequence[float]) -> tuple[float, ...]:
    """Return weights of the values at `times`, two or three of them, newest first, in the slope at the newest one."""
    new, last, *before = times
    h = new - last
    if not before:
        return 1.0 / h, -1.0 / h
    k = last - before[0]
    return 1.0 / h + 1.0 / (h + k), -(h + k) / (h * k), h / (k * (h + k))


def extrapolated(time: float, last: Sequence[Moment]) -> Values:
    """Return values at `time` by the polynomial through at most three moments, newest first; at a start, by their
    rates."""
    times, values = [moment.time for moment in last[:3]], [moment.values for moment in last[:3]]
    wanted = 2 if len(last) == 1 else 3
    while len(times) < wanted:
        back = time - last[0].time
        values.append(values[-1] - back * last[-1].rates)
        times.append(times[-1] - back)
    result = np.zeros_like(values[0])
    for k, value in enumerate(values):
        others = [t for j, t in enumerate(times) if j != k]
        result += float(np.prod([(time - t) / (times[k] - t) for t in others])) * value
    return result


def share_of_error(time: float, last: Sequence[Moment]) -> float:
    """Return the local error of a step as a share of the difference between its result and `extrapolated`.

    Both differ from the solution by multiples of its third derivative, of the second at a start: the result by
    h (h + k) / 6a with the leading weight a, the extrapolated value by -h (h + k) (h + k + l) / 6, after steps l, k, h.
    """
    if len(last) == 1:
        return 0.5
    h, k = time - last[0].time, last[0].time - last[1].time
    before = last[1].time - last[2].time if len(last) > 2 else h
    own = 1.0 / differences([time, last[0].time, last[1].time])[0]
    return own / (own + h + k + before)


class FluidInertia(FluidElements):
    """The fluid's inertia on a moving mesh: `FluidElements` with the rates of all coefficients, without viscosity."""

    def __init__(self, *arguments: Any, rates: Rates, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._rates = rates
        points = self._rule.number
        self._tests = np.ascontiguousarray(self._rule.momentum[:, :points])
        self._products = np.ascontiguousarray(self._rule.by_velocity[:, : 3 * points])

    def jacobian(self, state: Any) -> Entries:
        """Return entries of the Jacobian in the order of `places`; those of one place add up."""
        at = _Moving(self, state, self._density.Get())
        own = self._products @ np.concatenate(list(at.by_velocity()))
        blocks = [own, own]
        for i in (0, 1):
            blocks += [self._products @ np.concatenate(list(at.by_displacement(i, j))) for j in (0, 1)]
        loads = [block[:, self._loading] for block in blocks]
        return np.concatenate([block.ravel() for block in (*blocks, *loads)])

    def places(self) -> tuple[Numbers, Numbers]:
        few = self._loading
        blocks = [(i, self._v[i]) for i in (0, 1)] + [(i, columns) for i in (0, 1) for columns in self._d]
        loads = [(self._d[i][:, few], columns[:, few]) for i, columns in blocks]
        return placed([*((self._v[i], columns) for i, columns in blocks), *loads])

    def _residual(self, state: Any, viscosity: float, density: float) -> Values:
        at = _Moving(self, state, density)
        momentum = [self._tests @ force for force in at.forces()]
        loads = [part[:, self._loading] for part in momentum]
        weights = np.concatenate([part.ravel() for part in (*momentum, *loads)])
        return np.bincount(self._value_rows, weights=weights, minlength=self._size)

    @cached_property
    def _value_rows(self) -> Numbers:
        loads = [rows[:, self._loading] for rows in self._d]
        return np.concatenate([rows.ravel() for rows in (*self._v, *loads)])


class _Moving:
    """Fields at the quadrature points: ∇v, C, J, the velocity's rate a and the mesh's velocity u."""

    def __init__(self, fluid: FluidInertia, state: Any, density: float) -> None:
        values, rule = state.vec.FV().NumPy(), fluid._rule
        rates, shape = fluid._rates.first(values), (-1, rule.number, fluid._v[0].shape[1])
        self.density, self.leading = density, fluid._rates.leading
        self.gradient = [(rule.slopes @ values[dofs]).reshape(shape) for dofs in fluid._v]
        moved = [(rule.slopes @ values[dofs]).reshape(shape) for dofs in fluid._d]
        M = [[moved[i][k] + fluid._rest[i][k] for k in (0, 1)] for i in (0, 1)]
        self.C = [[M[1][1], -M[1][0]], [-M[0][1], M[0][0]]]
        self.J = M[0][0] * M[1][1] - M[0][1] * M[1][0]
        at_points = rule.velocity[: rule.number]
        self.a = [at_points @ rates[dofs] for dofs in fluid._v]
        self.u = [at_points @ rates[dofs] for dofs in fluid._d]

    @cached_property
    def _carried(self) -> list[AtPoints]:
        """ρ Cᵀu."""
        return [self.density * (self.C[0][k] * self.u[0] + self.C[1][k] * self.u[1]) for k in (0, 1)]

    def forces(self) -> Iterator[AtPoints]:
        """Yield the components of ρ (J a - ∇v Cᵀu)."""
        for i in (0, 1):
            carried = self.gradient[i][0] * self._carried[0] + self.gradient[i][1] * self._carried[1]
            yield self.density * self.J * self.a[i] - carried

    def by_velocity(self) -> Iterator[AtPoints]:
        """Yield the coefficients of value and slopes in the derivative of a component by the same one of v."""
        yield self.density * self.leading * self.J
        yield from (-carried for carried in self._carried)

    def by_displacement(self, i: int, j: int) -> Iterator[AtPoints]:
        """Yield the coefficients of value and slopes in the derivative of component i by component j of d."""
        g, C = self.gradient[i], self.C[j]
        yield -self.density * self.leading * (g[0] * C[0] + g[1] * C[1])
        turned = -self.u[1] if j == 0 else self.u[0]
        yield self.density * (self.a[i] * C[0] + g[1] * turned)
        yield self.density * (self.a[i] * C[1] - g[0] * turned)


class SolidInertia:
    """The solid's inertia: a constant mass matrix (scaled density) times the acceleration of the displacement."""

    def __init__(self, space: Any, solids: tuple[str, ...], *, density: float, rates: Rates) -> None:
        d, phi = space.TrialFunction()[2], space.TestFunction()[2]
        form = ng.BilinearForm(space)
        form += density * ng.InnerProduct(d, phi) * ng.dx("|".join(solids))
        form.Assemble()
        part = system.SymbolicPart(form)
        self._rates, self._places = rates, part.places()
        self._mass: Float[np.ndarray, " entry"] = np.array(form.mat.AsVector().FV().NumPy())

    def places(self) -> tuple[Numbers, Numbers]:
        return self._places

    def residual(self, state: Any) -> Values:
        return system.product(self._places, self._mass, self._rates.second(state.vec.FV().NumPy()))

    def jacobian(self, state: Any) -> Entries:
        """Return the entries of the mass matrix times the square of the leading weight."""
        return self._mass * self._rates.leading**2


class MovingSystem(system.CoupledSystem):
    """A `CoupledSystem` with inertia. On the interface the fluid's velocity is the rate of the displacement.

    That velocity is eliminated: it is an affine function of the displacement at the new time, so its columns of the
    Jacobian are added to those of the displacement. With `rates` at rest this is the steady system. `solid_density` is
    the scaled density of the undeformed solid.
    """

    def __init__(self, mesh: Any, boundaries: system.BoundaryNames, *, solid_density: float, **options: Any) -> None:
        super().__init__(mesh, boundaries, **options)
        self.rates = Rates(self.space.ndof)
        self._parts = (*self._parts, *self._inertia(solid_density))
        self._follows, self._leads = self._moved_by_solid()
        rows, columns = self._places
        self._on_interface = np.flatnonzero(np.isin(columns, self._follows))
        """Numbers of the entries in columns of the velocity on the interface."""
        target = np.arange(self.space.ndof)
        target[self._follows] = self._leads
        self.__dict__["_places"] = rows, target[columns]

    def set_unknowns(self, x: system.Vector) -> None:
        """Write the unknowns into the state, and the velocity on the interface that follows from them."""
        super().set_unknowns(x)
        values = self.values
        values[self._follows] = self.rates.first(values)[self._leads]

    def _inertia(self, solid_density: float) -> list[system.Term]:
        parts: list[system.Term] = []
        if "fluid" in self.mesh.GetMaterials():
            known = {"viscosity": self.viscosity, "density": self.density, "rates": self.rates}
            parts.append(FluidInertia(self.space, *system.fluid_cells(self.mesh), **known))
        if self.solids:
            parts.append(SolidInertia(self.space, self.solids, density=solid_density, rates=self.rates))
        return parts

    def _moved_by_solid(self) -> tuple[Numbers, Numbers]:
        """Return the numbers of the velocity's coefficients on the interface, and of the displacement's there."""
        if "fluid" not in self.mesh.GetMaterials() or not self.solids:
            return np.empty(0, int), np.empty(0, int)
        elements = [ng.ElementId(ng.VOL, int(cell)) for cell in system.fluid_cells(self.mesh)[0]]
        found = {k: np.concatenate([self.space.components[k].GetDofNrs(one) for one in elements]) for k in (0, 2)}
        v, d = (part + self.space.Range(k).start for k, part in found.items())
        shared = ~self.is_motion[d]
        follows, first = np.unique(v[shared], return_index=True)
        return follows, d[shared][first]

    def _assemble(self) -> Float[np.ndarray, " entry"]:
        entries = super()._assemble()
        entries[self._on_interface] *= self.rates.leading
        return entries

    @cached_property
    def _pattern(self) -> system.Pattern:
        kept, self.rates.leading = self.rates.leading, 1.0
        pattern = super()._pattern
        self.rates.leading = kept
        return pattern
