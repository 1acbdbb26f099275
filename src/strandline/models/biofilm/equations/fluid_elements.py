"""Residual and Jacobian of the fluid's balances in all elements at once, by hand; at the end, fields on triangles.

An element with the deformed map x(ξ) = X(ξ) + d(ξ) is integrated in the coordinates ξ of the reference triangle. With
∇ = ∂/∂ξ, M = ∇x, C = cof M, J = det M, g = ∇v M⁻¹ = ∇v Cᵀ/J and τ = μ (g + gᵀ) - p I, the balances of momentum and
mass, tested with w and q, are

    ∫ τ C : ∇w + ρ (∇v Cᵀ v) · w dξ    and    ∫ q C : ∇v dξ.

The geometry enters through M alone. So shape functions and weights are the same in all elements, and each block of the
Jacobian is one product of a constant matrix with coefficients at the quadrature points. In two dimensions C is linear
in M: ∂C_ik/∂M_jb = ε_ij ε_kb with ε = [[0, 1], [-1, 0]].

Source of the balances: Hron and Turek, A monolithic FEM/multigrid solver for an ALE formulation of fluid–structure
interaction (2006).
"""

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any

import ngsolve as ng
import numpy as np
from jaxtyping import Float, Int

ORDER = 6
"""Order of the quadrature rule: exact for all terms but the viscous one, which is rational."""

AtPoints = Float[np.ndarray, "point element"]
Numbers = Int[np.ndarray, " entry"]
Values = Float[np.ndarray, " dof"]
Vector = list[AtPoints]
Tensor = list[list[AtPoints]]
Entries = Float[np.ndarray, " entry"]


class FluidElements:
    """The fluid's elements: their unknowns, and what they add to the residual and the Jacobian.

    Components 0, 1 and 2 of `space` are v and d, quadratic, and p, linear. `cells` are triangles that may be curved;
    those among them that are `loading` touch the interface, where the traction loads the solid. Viscosity and density
    are scaled NGSolve parameters.
    """

    def __init__(
        self,
        space: Any,
        cells: Int[np.ndarray, " element"],
        loading: Int[np.ndarray, " marked"],
        *,
        viscosity: Any,
        density: Any,
    ) -> None:
        self._viscosity, self._density, self._size = viscosity, density, space.ndof
        self._v, self._p, self._d = (numbers_of(space, component, cells) for component in (0, 1, 2))
        self._loading = loading
        rule = ng.IntegrationRule(ng.TRIG, ORDER)
        self._rule, self._rest = Rule(space, rule), map_at_rest(space.mesh, cells, rule)

    def residual(self, state: Any) -> Values:
        """Return what the elements add to the residual of each row, from the coefficients in an NGSolve function."""
        return self._residual(state, self._viscosity.Get(), self._density.Get())

    def by_parameter(self, state: Any, parameter: Any) -> Values:
        """Return the derivative of the residual, which is linear in viscosity and density, by one of them, or 0."""
        one = [1.0 if parameter is given else 0.0 for given in (self._viscosity, self._density)]
        difference: Values = self._residual(state, one[0], one[1]) - self._residual(state, 0.0, 0.0)
        return difference

    def _residual(self, state: Any, viscosity: float, density: float) -> Values:
        at, rule = self._fields(state, viscosity, density), self._rule
        stress, C, gradient = at.stress, at.cofactor, at.gradient
        momentum = []
        for i in (0, 1):
            inertia = gradient[i][0] * at.transport[0] + gradient[i][1] * at.transport[1]
            flux = [stress[i][0] * C[0][k] + stress[i][1] * C[1][k] for k in (0, 1)]
            momentum.append(rule.momentum @ np.concatenate([inertia, *flux]))
        inflow = sum(C[i][k] * gradient[i][k] for i in (0, 1) for k in (0, 1))
        loads = [part[:, self._loading] for part in momentum]
        parts = [part.ravel() for part in (*momentum, rule.mass @ inflow, *loads)]
        return np.bincount(self._rows, weights=np.concatenate(parts), minlength=self._size)

    def jacobian(self, state: Any) -> Entries:
        at = self._fields(state, self._viscosity.Get(), self._density.Get())
        momentum = [block for i in (0, 1) for block in self._momentum_blocks(at, i)]
        loads = [block[:, self._loading] for block in momentum]
        mass = [self._rule.mass_by_slopes @ np.concatenate(one) for one in (*at.cofactor, *_cofactor(at.gradient))]
        return np.concatenate([block.ravel() for block in (*momentum, *mass, *loads)])

    def places(self) -> tuple[Numbers, Numbers]:
        """Return row and column of each entry of `jacobian`."""
        unknowns = (*self._v, *self._p, *self._d)
        momentum = [(rows, columns) for rows in self._v for columns in unknowns]
        mass = [(self._p[0], columns) for columns in (*self._v, *self._d)]
        few = self._loading
        loads = [(rows[:, few], columns[:, few]) for rows in self._d for columns in unknowns]
        return placed([*momentum, *mass, *loads])

    @cached_property
    def _rows(self) -> Numbers:
        loads = [rows[:, self._loading] for rows in self._d]
        return np.concatenate([rows.ravel() for rows in (*self._v, *self._p, *loads)])

    def _fields(self, state: Any, viscosity: float, density: float) -> "_Fields":
        values = state.vec.FV().NumPy()
        rule, shape = self._rule, (-1, self._rule.number, self._v[0].shape[1])
        v = [(rule.velocity @ values[dofs]).reshape(shape) for dofs in self._v]
        moved = [(rule.slopes @ values[dofs]).reshape(shape) for dofs in self._d]
        M = [[moved[i][k] + self._rest[i][k] for k in (0, 1)] for i in (0, 1)]
        p = rule.pressure @ values[self._p[0]]
        gradient = [[v[i][1], v[i][2]] for i in (0, 1)]
        return _Fields([v[0][0], v[1][0]], gradient, M, p, viscosity, density)

    def _momentum_blocks(self, at: "_Fields", i: int) -> Iterator[Float[np.ndarray, "pair element"]]:
        """Yield the derivatives of component i of the momentum by v₀, v₁, p, d₀, d₁."""
        for j in (0, 1):
            yield self._rule.by_velocity @ np.concatenate(list(at.momentum_by_velocity(i, j)))
        yield self._rule.by_pressure @ np.concatenate([-one for one in at.cofactor[i]])
        for j in (0, 1):
            yield self._rule.by_displacement @ np.concatenate(list(at.momentum_by_displacement(i, j)))


class _Fields:
    """Fields at the quadrature points from v, ∇v, M and p there, all scaled, with S = (μ/J) CᵀC and (μ/J) C."""

    def __init__(self, v: Vector, gradient: Tensor, M: Tensor, p: AtPoints, viscosity: float, density: float) -> None:
        self.v, self.gradient, self.density, self.cofactor = v, gradient, density, _cofactor(M)
        C = self.cofactor
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1.0 / (M[0][0] * M[1][1] - M[0][1] * M[1][0])
            g = [[(gradient[i][0] * C[j][0] + gradient[i][1] * C[j][1]) * inverse for j in (0, 1)] for i in (0, 1)]
            shear = viscosity * (g[0][1] + g[1][0])
            self.stress = [[2 * viscosity * g[0][0] - p, shear], [shear, 2 * viscosity * g[1][1] - p]]
            self.viscous = [[viscosity * inverse * C[i][k] for k in (0, 1)] for i in (0, 1)]
        self.g, self.transport = g, [density * (C[0][k] * v[0] + C[1][k] * v[1]) for k in (0, 1)]

    @cached_property
    def metric(self) -> Tensor:
        """S."""
        C, mC = self.cofactor, self.viscous
        off = mC[0][0] * C[0][1] + mC[1][0] * C[1][1]
        return [[mC[0][0] * C[0][0] + mC[1][0] * C[1][0], off], [off, mC[0][1] * C[0][1] + mC[1][1] * C[1][1]]]

    @cached_property
    def pulled(self) -> Tensor:
        """gᵀ C."""
        g, C = self.g, self.cofactor
        return [[g[0][j] * C[0][a] + g[1][j] * C[1][a] for a in (0, 1)] for j in (0, 1)]

    def momentum_by_velocity(self, i: int, j: int) -> Iterator[AtPoints]:
        """Yield ρ ∇v_i·C_j and δ_ij ρ Cᵀv, then for all a, b: (μ/J) C_ib C_ja + δ_ij S_ab."""
        C, gradient = self.cofactor, self.gradient[i]
        yield self.density * (gradient[0] * C[j][0] + gradient[1] * C[j][1])
        yield from (one if i == j else np.zeros_like(one) for one in self.transport)
        for a in (0, 1):
            for b in (0, 1):
                crossed = self.viscous[i][b] * C[j][a]
                yield crossed + self.metric[a][b] if i == j else crossed

    def momentum_by_displacement(self, i: int, j: int) -> Iterator[AtPoints]:
        """Yield ρ (∇v ε)_ib (vᵀε)_j, then for all a, b: (τε)_ij ε_ab - g_ij S_ab - (μ/J) C_ib (gᵀC)_ja."""
        turned = self.density * (-self.v[1] if j == 0 else self.v[0])
        yield -self.gradient[i][1] * turned
        yield self.gradient[i][0] * turned
        pushed = -self.stress[i][1] if j == 0 else self.stress[i][0]
        for a in (0, 1):
            for b in (0, 1):
                sheared = self.g[i][j] * self.metric[a][b] + self.viscous[i][b] * self.pulled[j][a]
                yield -sheared if a == b else (pushed if a == 0 else -pushed) - sheared


def _cofactor(A: Tensor) -> Tensor:
    return [[A[1][1], -A[1][0]], [-A[0][1], A[0][0]]]


class Rule:
    """Constant matrices, in the coordinates of the reference triangle, for quadratic and linear fields.

    They give fields at the points of a quadrature rule from coefficients for the shape functions of `space`, and
    integrals over an element from values at these points.
    """

    def __init__(self, space: Any, rule: Any) -> None:
        points, weights = np.array([point[:2] for point in rule.points]), np.array(rule.weights)
        first = ng.ElementId(ng.VOL, 0)
        quadratic, linear = (ng.H1(space.mesh, order=order).GetFE(first) for order in (2, 1))
        value = np.array([list(quadratic.CalcShape(x, y)) for x, y in points])
        slope = np.array([np.array(quadratic.CalcDShape(x, y)) for x, y in points])
        plain = np.array([list(linear.CalcShape(x, y)) for x, y in points])
        N = np.stack([value, slope[:, :, 0], slope[:, :, 1]])

        def integrals(test: Any, trial: Any) -> Any:
            return np.einsum("aqi,bqj,q->ijabq", test, trial, weights).reshape(test.shape[2] * trial.shape[2], -1)

        self.number = len(weights)
        self.velocity: Float[np.ndarray, "value 6"] = N.reshape(-1, 6)
        """Value and slopes of a quadratic field, (3 point, 6)."""
        self.slopes = self.velocity[self.number :]
        """Slopes of a quadratic field, (2 point, 6)."""
        self.pressure: Float[np.ndarray, "point 3"] = plain
        """Value of a linear field."""
        self.momentum = np.ascontiguousarray((N * weights[:, None]).reshape(-1, 6).T)
        """Integrals of values and slopes of the quadratic test functions, (6, 3 point)."""
        self.mass = np.ascontiguousarray((plain * weights[:, None]).T)
        """Integrals of values of the linear test functions, (3, point)."""
        self.by_velocity = np.hstack([integrals(N[:1], N), integrals(N[1:], N[1:])])
        """Integrals of test times trial functions, (36, 7 point), for the coefficients in `_Fields`."""
        self.by_displacement = np.hstack([integrals(N[:1], N[1:]), integrals(N[1:], N[1:])])
        """The same for slopes of the trial functions alone, (36, 6 point)."""
        self.by_pressure = integrals(N[1:], plain[None])
        """The same for slopes of the test functions and values of linear trial functions, (18, 2 point)."""
        self.mass_by_slopes = integrals(plain[None], N[1:])
        """The same for values of linear test functions and slopes of trial functions, (18, 2 point)."""
        self.mass_by_values = integrals(plain[None], plain[None])
        """The same for values of linear test and trial functions, (9, point)."""


def numbers_of(space: Any, component: int, cells: Int[np.ndarray, " element"]) -> Int[np.ndarray, "axis node element"]:
    """Return the numbers of a field's coefficients, one block for each axis; fields 0 and 2, v and d, are quadratic."""
    start, part = space.Range(component).start, space.components[component]
    found = np.array([part.GetDofNrs(ng.ElementId(ng.VOL, int(cell))) for cell in cells]) + start
    return np.ascontiguousarray(found.reshape(len(cells), -1, 6 if component in (0, 2) else 3).transpose(1, 2, 0))


def map_at_rest(
    mesh: Any, cells: Int[np.ndarray, " element"], rule: Any
) -> Float[np.ndarray, "axis slope point element"]:
    """Return ∂X/∂ξ at the points of each element."""

    def slopes(cell: int) -> Float[np.ndarray, "point 2 2"]:
        at_rest = mesh.GetTrafo(ng.ElementId(ng.VOL, cell))
        points = [at_rest(*point.point[:2]) for point in rule]  # the map must outlive them, and they their slopes
        return np.array([np.array(point.jacobi) for point in points])

    maps = np.stack([slopes(int(cell)) for cell in cells], axis=-1)
    return np.ascontiguousarray(maps.transpose(1, 2, 0, 3))


def placed(blocks: Sequence[tuple[Int[np.ndarray, "_ _"], Int[np.ndarray, "_ _"]]]) -> tuple[Numbers, Numbers]:
    """Return row and column of each entry of blocks (row × column, element), given the numbers of each one's sides."""
    found = [np.broadcast_arrays(rows[:, None], columns[None]) for rows, columns in blocks]
    rows, columns = (np.concatenate([pair[k].ravel() for pair in found]) for k in (0, 1))
    return rows, columns
