"""What inertia adds to the balances of momentum when the state changes with time, and the mesh of the fluid moves.

In the notation of `fluid_elements`, with the rate of change a of the velocity at a point of the moving mesh and the
mesh's own velocity u, the fluid's balance gains ∫ ρ (J a - ∇v Cᵀu) · w dξ. Where v is linear in space this vanishes to
rounding on any moving mesh, if a and u are the same differences in time of v and of the displacement: the geometric
conservation law. The solid's balance gains ∫ ρₛ d̈ · φ over the undeformed solid.

Source: Donea, Huerta, Ponthot and Rodríguez-Ferran, Arbitrary Lagrangian–Eulerian Methods, in: Encyclopedia of
Computational Mechanics (2004), equation (16), the form that is not conservative; Lesoinne and Farhat, Comput. Methods
Appl. Mech. Eng. 134 (1996) 71, for the geometric conservation law.
"""

from collections.abc import Iterator
from functools import cached_property
from typing import Any

import ngsolve as ng
import numpy as np
from jaxtyping import Float, Int

from strandline.models.biofilm.assembly import SymbolicPart, product
from strandline.models.biofilm.fluid_elements import Entries, FluidElements, Values
from strandline.models.biofilm.rates import Rates
from strandline.models.biofilm.triangles import AtPoints, Numbers, places_of

__all__ = ["FluidInertia", "SolidInertia"]


class FluidInertia(FluidElements):
    """The fluid's inertia on a moving mesh in all elements at once; same arguments as `FluidElements`.

    Args:
        space: Space of the coupled system.
        cells: Numbers of the fluid's elements.
        loading: Which of them touch the interface.
        viscosity: NGSolve parameter, without effect.
        density: NGSolve parameter, scaled density.
        rates: Rates of all coefficients.
    """

    def __init__(
        self,
        space: Any,
        cells: Int[np.ndarray, " element"],
        loading: Int[np.ndarray, " marked"],
        *,
        viscosity: Any,
        density: Any,
        rates: Rates,
    ) -> None:
        super().__init__(space, cells, loading, viscosity=viscosity, density=density)
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
        """Return row and column of each entry of `jacobian`."""
        few = self._loading
        blocks = [(i, self._v[i]) for i in (0, 1)] + [(i, columns) for i in (0, 1) for columns in self._d]
        pairs = [places_of(self._v[i], columns) for i, columns in blocks]
        pairs += [places_of(self._d[i][:, few], columns[:, few]) for i, columns in blocks]
        return np.concatenate([rows for rows, _ in pairs]), np.concatenate([columns for _, columns in pairs])

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
    """The solid's inertia: a constant mass matrix times the acceleration of the displacement.

    Args:
        space: Space of the coupled system, whose component 2 is d.
        solids: Names of the solid's regions.
        density: Scaled density of the undeformed solid.
        rates: Rates of all coefficients.
    """

    def __init__(self, space: Any, solids: tuple[str, ...], *, density: float, rates: Rates) -> None:
        d, phi = space.TrialFunction()[2], space.TestFunction()[2]
        form = ng.BilinearForm(space)
        form += density * ng.InnerProduct(d, phi) * ng.dx("|".join(solids))
        form.Assemble()
        part = SymbolicPart(form)
        self._rates, self._places = rates, part.places()
        self._mass: Float[np.ndarray, " entry"] = np.array(form.mat.AsVector().FV().NumPy())

    def places(self) -> tuple[Numbers, Numbers]:
        """Return row and column of each entry of `jacobian`."""
        return self._places

    def residual(self, state: Any) -> Values:
        """Return the mass times the acceleration."""
        return product(self._places, self._mass, self._rates.second(state.vec.FV().NumPy()))

    def jacobian(self, state: Any) -> Entries:
        """Return the entries of the mass matrix times the square of the leading weight."""
        return self._mass * self._rates.leading**2
