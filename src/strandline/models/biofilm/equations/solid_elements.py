"""Residual and Jacobian of the solid in all elements at once, for isotropic laws; derivatives by hand.

With F = I + ∇d, b = F C, c = F⁻ᵀ and the coefficients of an `IsotropicLaw`, the first Piola–Kirchhoff stress is
P = F S = α F + β b + γ c. The balance of momentum and the law's constraint, tested with φ and q, are

    ∫ P : ∇φ - f · φ dX    and    ∫ q (ν volume - (1+ν)(1-2ν)/E pₛ) dX.

Derivatives of tensors follow from ∂c_iA/∂F_jB = -c_iB c_jA and ∂b_iA/∂F_jB = δ_ij C_AB + F_iB F_jA + (FFᵀ)_ij δ_AB,
those of α, β, γ from ∂I₁/∂F = 2F and ∂ln J/∂F = c. Sums over A turn ∂/∂X_A into ∂/∂ξ_k of the reference triangle.

Source: Holzapfel, Nonlinear Solid Mechanics (2000), sections 2.5 and 6.2.
"""

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any

import ngsolve as ng
import numpy as np
from jaxtyping import Float, Int

from strandline.models.biofilm.equations.fluid_elements import AtPoints, Numbers, Rule, map_at_rest, numbers_of, placed
from strandline.models.biofilm.materials.isotropic import IsotropicLaw, Jet
from strandline.models.biofilm.materials.law import compliance, shear_modulus

ORDER = 6
"""Order of the quadrature rule, that of the symbolic forms: exact for Saint-Venant and Kirchhoff's law."""

RELATIVE_STEP = 1e-4  # step of the difference by Young's modulus; all laws here are linear in it
Values = Float[np.ndarray, " dof"]
Entries = Float[np.ndarray, " entry"]
Tensor = list[list[AtPoints]]


class SolidElements:
    """The solid's elements: their unknowns, and what they add to the residual and the Jacobian.

    Args:
        space: Space of the coupled system, whose component 2 is d, and whose last ones are pₛ of each region.
        law: Isotropic law.
        cells: Numbers of each region's elements, triangles that may be curved.
        material: NGSolve parameters, each by region: Young's modulus, Poisson's ratio, those of the law.
        body_force: Scaled force per volume of the undeformed solid.
    """

    def __init__(
        self,
        space: Any,
        law: IsotropicLaw,
        cells: Sequence[Int[np.ndarray, " _"]],
        *,
        material: Sequence[Sequence[Any]],
        body_force: tuple[float, float],
    ) -> None:
        self._law, self._material, self._size = law, material, space.ndof
        self.profile: Float[np.ndarray, " vertex"] | None = None
        """Factor of Young's modulus at each of `vertices`, linear between them; None: 1."""
        every = np.concatenate(list(cells))
        self._region = np.repeat(np.arange(len(cells)), [len(part) for part in cells])
        self._d = numbers_of(space, 2, every)
        self._p = np.concatenate([numbers_of(space, 3 + k, part)[0] for k, part in enumerate(cells)], axis=1)
        corners = [[corner.nr for corner in space.mesh[ng.ElementId(ng.VOL, int(cell))].vertices] for cell in every]
        self.vertices, self._corners = np.unique(np.array(corners).T, return_inverse=True)
        """Numbers of the mesh's vertices in the solid, and which of these are each element's corners (3, element)."""
        rule = ng.IntegrationRule(ng.TRIG, ORDER)
        self._rule = Rule(space, rule)
        rest = map_at_rest(space.mesh, every, rule)
        self._weight: AtPoints = rest[0][0] * rest[1][1] - rest[0][1] * rest[1][0]
        """det ∂X/∂ξ."""
        self._inverse: Tensor = [
            [rest[1][1] / self._weight, -rest[0][1] / self._weight],
            [-rest[1][0] / self._weight, rest[0][0] / self._weight],
        ]
        """∂ξ_k/∂X_A."""
        points = self._rule.number
        self._slope_tests = np.ascontiguousarray(self._rule.momentum[:, points:])
        self._slope_products = np.ascontiguousarray(self._rule.by_velocity[:, 3 * points :])
        pushed = self._rule.momentum[:, :points] @ self._weight
        self._force = [force * pushed for force in body_force]

    @property
    def areas(self) -> Float[np.ndarray, " vertex"]:
        """Integral of the linear shape function of each of `vertices`."""
        shares = self._rule.mass @ np.abs(self._weight)
        return np.bincount(self._corners.ravel(), weights=shares.ravel(), minlength=len(self.vertices))

    def residual(self, state: Any) -> Values:
        """Return what the elements add to the residual of each row, from the coefficients in an NGSolve function."""
        with np.errstate(all="ignore"):  # what is not finite is refused by the system
            at = self._at_points(state)
            momentum = [self._slope_tests @ np.concatenate(at.stress(i)) - self._force[i] for i in (0, 1)]
            parts = (*momentum, self._rule.mass @ (self._weight * at.constraint))
        return np.bincount(self._rows, weights=np.concatenate([part.ravel() for part in parts]), minlength=self._size)

    def jacobian(self, state: Any) -> Entries:
        """Return entries of the Jacobian in the order of `places`; those of one place add up."""
        with np.errstate(all="ignore"):
            blocks = self._blocks(self._at_points(state))
        return np.concatenate([block.ravel() for block in blocks])

    def by_profile(self, state: Any, tests: Float[np.ndarray, "test dof"]) -> Float[np.ndarray, "test vertex"]:
        """Return the derivatives of tests · residual by the factor of Young's modulus at each of `vertices`."""
        at, rule, shape = self._at_points(state), self._rule, (2, self._rule.number, -1)
        young = np.array([parameter.Get() for parameter in self._material[0]])[self._region]
        stresses = [np.concatenate(at.stress_by_young(i)) for i in (0, 1)]
        found = np.empty((len(tests), len(self.vertices)))
        for test, row in zip(tests, found, strict=True):
            work = sum((self._slope_tests.T @ test[d]) * stress for d, stress in zip(self._d, stresses, strict=True))
            work = np.reshape(work, shape).sum(axis=0) + (rule.mass.T @ test[self._p]) * at.constraint_by_young
            at_corners = rule.pressure.T @ (young * work)
            row[:] = np.bincount(self._corners.ravel(), weights=at_corners.ravel(), minlength=len(row))
        return found

    def _blocks(self, at: "_AtPoints") -> list[Float[np.ndarray, "pair element"]]:
        """Return the derivatives of each component of the momentum and of the constraint by d₀, d₁, pₛ."""
        rule, blocks = self._rule, []
        for i in (0, 1):
            blocks += [self._slope_products @ np.concatenate(list(at.by_displacement(i, j))) for j in (0, 1)]
            blocks.append(rule.by_pressure @ np.concatenate(at.by_pressure(i)))
        blocks += [rule.mass_by_slopes @ np.concatenate(at.constraint_by_displacement(j)) for j in (0, 1)]
        blocks.append(rule.mass_by_values @ (-at.compliance * self._weight))
        return blocks

    def places(self) -> tuple[Numbers, Numbers]:
        """Return row and column of each entry of `jacobian`."""
        unknowns = (*self._d, self._p)
        return placed([(rows, columns) for rows in unknowns for columns in unknowns])

    @cached_property
    def _rows(self) -> Numbers:
        return np.concatenate([rows.ravel() for rows in (*self._d, self._p)])

    def _at_points(self, state: Any) -> "_AtPoints":
        values = state.vec.FV().NumPy()
        rule, inverse, shape = self._rule, self._inverse, (2, self._rule.number, self._p.shape[1])
        moved = [(rule.slopes @ values[numbers]).reshape(shape) for numbers in self._d]
        F = [
            [float(i == A) + moved[i][0] * inverse[0][A] + moved[i][1] * inverse[1][A] for A in (0, 1)] for i in (0, 1)
        ]
        material = [np.array([parameter.Get() for parameter in group])[self._region] for group in self._material]
        if self.profile is not None:
            material[0] = material[0] * (rule.pressure @ self.profile[self._corners])
        return _AtPoints(self._law, F, rule.pressure @ values[self._p], material, inverse, self._weight)


class _AtPoints:
    """Stress and constraint at the quadrature points, and their derivatives, times the weight det ∂X/∂ξ.

    Indices k and m belong to ∂/∂ξ; a tensor is turned if its second index has become one of these.
    """

    def __init__(
        self,
        law: IsotropicLaw,
        F: Tensor,
        pressure: AtPoints,
        material: Sequence[np.ndarray],
        inverse: Tensor,
        weight: AtPoints,
    ) -> None:
        young, poisson, *further = material
        self._inverse, self._weight, self._poisson = inverse, weight, poisson
        self.F = F
        self.C: Tensor = [[F[0][A] * F[0][B] + F[1][A] * F[1][B] for B in (0, 1)] for A in (0, 1)]
        J = F[0][0] * F[1][1] - F[0][1] * F[1][0]
        self.c: Tensor = [[F[1][1] / J, -F[1][0] / J], [-F[0][1] / J, F[0][0] / J]]
        measures = Jet.variables(self.C[0][0] + self.C[1][1] + 1.0, np.log(J), pressure)
        shear = shear_modulus(young, poisson)

        def coefficients(factor: float) -> list[Jet]:
            return [Jet.of(number) for number in law.coefficients(*measures, factor * shear, *further)]

        self.coefficients, self._coefficients, self._young = coefficients(1.0), coefficients, young
        self._volume = Jet.of(law.volume(*measures[:2]))
        self.compliance: Float[np.ndarray, "*point element"] = compliance(young, poisson)
        self._eased: AtPoints = self.compliance * pressure
        self.constraint: AtPoints = poisson * self._volume.value - self._eased

    def stress(self, i: int) -> list[AtPoints]:
        """Return row i of P, by k."""
        return self._row(i, *(number.value for number in self.coefficients))

    def stress_by_young(self, i: int) -> list[AtPoints]:
        """Return the derivative of row i of P by Young's modulus, by k: exact but for rounding if linear in it."""
        lower, upper = (self._coefficients(1.0 + sign * RELATIVE_STEP) for sign in (-1, 1))
        span = 2 * RELATIVE_STEP * self._young
        return self._row(i, *((up.value - low.value) / span for low, up in zip(lower, upper, strict=True)))

    @property
    def constraint_by_young(self) -> AtPoints:
        """Derivative of the constraint by Young's modulus."""
        return np.asarray(self._weight * self._eased / self._young)

    def _row(self, i: int, alpha: Any, beta: Any, gamma: Any) -> list[AtPoints]:
        P = [alpha * self.F[i][A] + beta * self._b[i][A] + gamma * self.c[i][A] for A in (0, 1)]
        return [self._weight * (P[0] * self._inverse[k][0] + P[1] * self._inverse[k][1]) for k in (0, 1)]

    def by_pressure(self, i: int) -> list[AtPoints]:
        """Return the derivative of row i of P by pₛ, by k."""
        slopes = [number.slopes[2] for number in self.coefficients]
        return [
            self._weight * sum(slope * of[i][k] for slope, of in zip(slopes, self._terms, strict=True)) for k in (0, 1)
        ]

    def by_displacement(self, i: int, j: int) -> Iterator[AtPoints]:
        """Yield the derivatives of row i of P by the slopes of d_j, for all k, m."""
        alpha, beta, gamma = (number.value for number in self.coefficients)
        F, _, c = self._terms
        across = self.F[i][0] * self.F[j][0] + self.F[i][1] * self.F[j][1]
        for k in (0, 1):
            for m in (0, 1):
                found = beta * (F[i][m] * F[j][k] + across * self._metric[k][m]) - gamma * c[i][m] * c[j][k]
                for term, gradient in zip(self._terms, self._gradients, strict=True):
                    found = found + term[i][k] * gradient[j][m]
                if i == j:
                    found = found + alpha * self._metric[k][m] + beta * self._strained[k][m]
                yield self._weight * found

    def constraint_by_displacement(self, j: int) -> list[AtPoints]:
        """Return the derivative of the constraint by the slopes of d_j, by m."""
        gradient = self._gradient(self._volume)
        return [self._weight * self._poisson * gradient[j][m] for m in (0, 1)]

    @cached_property
    def _b(self) -> Tensor:
        F, C = self.F, self.C
        return [[F[i][0] * C[0][A] + F[i][1] * C[1][A] for A in (0, 1)] for i in (0, 1)]

    @cached_property
    def _terms(self) -> tuple[Tensor, Tensor, Tensor]:
        """F, b and c with their second index turned."""
        return self._turned(self.F), self._turned(self._b), self._turned(self.c)

    @cached_property
    def _gradients(self) -> list[Tensor]:
        """Derivatives of α, β and γ by the slopes of d."""
        return [self._gradient(number) for number in self.coefficients]

    def _gradient(self, number: Jet) -> Tensor:
        """Return the derivative of a coefficient by the slopes of d."""
        F, _, c = self._terms
        by_invariant, by_log_volume, _ = number.slopes
        return [[2 * by_invariant * F[j][m] + by_log_volume * c[j][m] for m in (0, 1)] for j in (0, 1)]

    @cached_property
    def _metric(self) -> Tensor:
        inverse = self._inverse
        return [[inverse[k][0] * inverse[m][0] + inverse[k][1] * inverse[m][1] for m in (0, 1)] for k in (0, 1)]

    @cached_property
    def _strained(self) -> Tensor:
        """C with both indices turned."""
        return self._turned([list(row) for row in zip(*self._turned(self.C), strict=True)])

    def _turned(self, tensor: Tensor) -> Tensor:
        inverse = self._inverse
        return [[row[0] * inverse[k][0] + row[1] * inverse[k][1] for k in (0, 1)] for row in tensor]
