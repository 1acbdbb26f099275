"""Newton's method with the natural monotonicity test and quasi-Newton steps between Jacobians.

Source: Deuflhard, Newton Methods for Nonlinear Problems (2004), section 3.3 (error-oriented damping, NLEQ-ERR) and
section 2.1.4 (error-oriented quasi-Newton updates, QNERR). A step λΔx is accepted if the *simplified* correction it
leaves, -J(x)⁻¹ r(x + λΔx), is shorter than Δx. That test is invariant under scaling of the equations; the norm of the
residual is not, and stalls on bending. After a full step that contracts well, Broyden's good update replaces new
Jacobians: a Jacobian, assembled and factorised, costs as much as ten such steps.
"""

from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from strandline.foundations import ForwardModelError

Vector = Float[np.ndarray, " unknown"]


@runtime_checkable
class LinearSolver(Protocol):
    """A factorised Jacobian."""

    def solve(self, right: Vector) -> Vector: ...


@runtime_checkable
class System(Protocol):
    """A nonlinear system r(x) = 0; both methods may raise ForwardModelError."""

    def residual(self, x: Vector) -> Vector: ...

    def factorise(self, x: Vector) -> LinearSolver: ...


@dataclass(frozen=True)
class NewtonSettings:
    """When to stop: by the length of the last correction, the number of Jacobians, or the smallest damping factor.

    With a smallest damping of 1 only full steps are taken. Quasi-Newton steps reuse a Jacobian as long as each is
    shorter than the last by the `contraction`.
    """

    tolerance: float = 1e-9
    maximum_jacobians: int = 16
    smallest_damping: float = 0.02
    contraction: float = 0.5


@dataclass(frozen=True, eq=False)
class NewtonSolution:
    """The root, Jacobians factorised, steps with a Jacobian from elsewhere, and the last Jacobian, near the root."""

    x: Vector
    jacobians: int
    simplified_steps: int
    jacobian: LinearSolver


@dataclass(frozen=True, eq=False)
class NewtonStep:
    """A factorised Jacobian and the undamped correction that it gives."""

    jacobian: LinearSolver
    correction: Vector


def step(system: System, x: Vector, jacobian: LinearSolver | None = None) -> NewtonStep:
    """Return Newton's step at `x`, with a Jacobian from elsewhere if one is given; raises what `system` raises."""
    jacobian = system.factorise(x) if jacobian is None else jacobian
    return NewtonStep(jacobian, -jacobian.solve(system.residual(x)))


def solve(
    system: System, x: Vector, *, weights: Vector, settings: NewtonSettings, first: NewtonStep | None = None
) -> NewtonSolution:
    """Return the root of `system` that Newton's method reaches from `x`; `weights` belong to the norm of corrections.

    The step at `x` may be given as `first`; its Jacobian is not counted.

    Raises:
        ForwardModelError: ``newton_stalled`` (damping below its bound), ``newton_maxit``, or what `system` raises. Its
            evidence holds the number of `jacobians` and of `simplified_steps`, unless `system` has given its own.
    """
    search = _Search(system, weights, settings)
    try:
        return search.run(x, first)
    except ForwardModelError as error:
        spent = {"jacobians": float(search.jacobians), "simplified_steps": float(search.steps)}
        raise ForwardModelError(error.kind, error.message, spent | dict(error.evidence)) from error


def solve_again(
    system: System, x: Vector, jacobian: LinearSolver | None, *, weights: Vector, settings: NewtonSettings
) -> NewtonSolution:
    """Return the root as `solve` does: with a Jacobian from elsewhere first, if there is one, then with new ones."""
    if jacobian is not None:
        with suppress(ForwardModelError):
            return solve(system, x, weights=weights, settings=settings, first=step(system, x, jacobian))
    return solve(system, x, weights=weights, settings=settings)


class _Search:
    """One run of the method; counts what it spends."""

    def __init__(self, system: System, weights: Vector, settings: NewtonSettings) -> None:
        self.system, self.weights, self.settings = system, weights, settings
        self.jacobians, self.steps = 0, 0

    def run(self, x: Vector, first: NewtonStep | None) -> NewtonSolution:
        """Iterate from x until convergence or a reason to stop; a known first step is reused."""
        damping, previous, taken = 1.0, None, first
        while True:
            if taken is None:
                self.jacobians += 1
                taken = step(self.system, x)
            jacobian, correction = taken.jacobian, taken.correction
            size = self._length(correction)
            if size <= self.settings.tolerance:
                return NewtonSolution(x + correction, self.jacobians, self.steps, jacobian)
            if previous is not None:
                damping = self._predicted_damping(correction, previous)
            damping, simplified = self._damped_step(jacobian, x, correction, damping)
            previous = (size * damping, simplified)
            x = x + damping * correction
            if damping == 1.0 and self._length(simplified) <= self.settings.contraction * size:
                x, last = self._quasi_newton(jacobian, x, (correction, simplified))
                if last <= self.settings.tolerance:
                    return NewtonSolution(x, self.jacobians, self.steps, jacobian)
                previous = None
            taken = None
            if self.jacobians >= self.settings.maximum_jacobians:
                spent = f"{self.settings.maximum_jacobians} Jacobians (last correction {size:.2g})"
                raise ForwardModelError("newton_maxit", f"no convergence within {spent}", {"last_correction": size})

    def _length(self, correction: Vector) -> float:
        """Return the weighted root mean square of a correction."""
        return float(np.linalg.norm(self.weights * correction) / np.sqrt(len(correction)))

    def _inner(self, a: Vector, b: Vector) -> float:
        return float((self.weights * a) @ (self.weights * b))

    def _damped_step(
        self, jacobian: LinearSolver, x: Vector, correction: Vector, damping: float
    ) -> tuple[float, Vector]:
        """Return the accepted damping factor and the simplified correction it leaves."""
        size = self._length(correction)
        while damping >= self.settings.smallest_damping:
            try:
                simplified = -jacobian.solve(self.system.residual(x + damping * correction))
            except ForwardModelError:
                damping *= 0.5
                continue
            self.steps += 1
            if self._length(simplified) <= (1.0 - 0.25 * damping) * size:
                return damping, simplified
            curvature = self._length(simplified - (1.0 - damping) * correction)
            damping = min(0.5 * damping, 0.5 * size * damping**2 / curvature)
        limit = f"{self.settings.smallest_damping:g} of the correction ({size:.2g})"
        message = f"Newton's steps became shorter than {limit}"
        raise ForwardModelError("newton_stalled", message, {"last_correction": size})

    def _quasi_newton(
        self, jacobian: LinearSolver, x: Vector, corrections: tuple[Vector, Vector]
    ) -> tuple[Vector, float]:
        """Continue with Broyden updates of a Jacobian while they contract; return the point and the last correction.

        `x` is the point after the first correction, which is the Newton step; the second is what that leaves.
        """
        directions = [corrections[0]]
        squares = [self._inner(corrections[0], corrections[0])]
        left = corrections[1]
        while True:
            for k in range(1, len(directions)):
                left = left + (self._inner(left, directions[k - 1]) / squares[k - 1]) * directions[k]
            along = self._inner(left, directions[-1]) / squares[-1]
            contraction = np.sqrt(self._inner(left, left) / squares[-1])
            if contraction > self.settings.contraction or not np.isfinite(contraction):
                return x, max(self._length(left), 2 * self.settings.tolerance)
            directions.append(left / (1.0 - along))
            squares.append(self._inner(directions[-1], directions[-1]))
            x = x + directions[-1]
            last = self._length(directions[-1])
            if last <= self.settings.tolerance:
                return x, last
            self.steps += 1
            left = -jacobian.solve(self.system.residual(x))

    def _predicted_damping(self, correction: Vector, previous: tuple[float, Vector]) -> float:
        """Return Deuflhard's a-priori damping factor (3.49) from the last step taken and the correction it left."""
        step, simplified = previous
        difference = self._length(simplified - correction) * self._length(correction)
        return 1.0 if difference == 0.0 else float(min(1.0, max(0.1, step * self._length(simplified) / difference)))
