"""Newton's method with the natural monotonicity test and simplified (frozen-Jacobian) steps.

Source: Deuflhard, Newton Methods for Nonlinear Problems (2004), section 3.3 (error-oriented damping, NLEQ-ERR) and 2.1
(simplified Newton). A step λΔx is accepted where the *simplified* correction it leaves, -J(x)⁻¹ r(x + λΔx), is shorter
than Δx. That test is invariant under scaling of the equations; the norm of the residual is not, and stalls on bending.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from strandline.errors import ForwardModelError

__all__ = ["NewtonSettings", "NewtonSolution", "solve"]

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
    """When to stop.

    Args:
        tolerance: length of the last correction, in the norm of the caller.
        maximum_jacobians: bound on the cost: a Jacobian costs as much as ten or more simplified steps.
        smallest_damping: below it the iteration has stalled.
        frozen_contraction: the Jacobian is kept while a simplified step shrinks the correction by this factor.
    """

    tolerance: float = 1e-9
    maximum_jacobians: int = 16
    smallest_damping: float = 0.02
    frozen_contraction: float = 0.1


@dataclass(frozen=True, eq=False)
class NewtonSolution:
    """The root, the number of Jacobians and of simplified steps it took, and the length of the last correction."""

    x: Vector
    jacobians: int
    simplified_steps: int
    last_correction: float


def solve(
    system: System,
    x: Vector,
    *,
    norm: Callable[[Vector], float],
    settings: NewtonSettings,
) -> NewtonSolution:
    """Return the root of `system` that Newton's method reaches from `x`.

    Raises:
        ForwardModelError: ``newton_stalled`` (damping below its bound), ``newton_maxit``, or what `system` raises.
    """
    damping, steps, previous = 1.0, 0, None
    for jacobians in range(1, settings.maximum_jacobians + 1):
        jacobian = system.factorise(x)
        correction = -jacobian.solve(system.residual(x))
        length = norm(correction)
        if length <= settings.tolerance:
            return NewtonSolution(x + correction, jacobians, steps, length)
        if previous is not None:
            damping = _predicted_damping(correction, norm=norm, previous=previous)
        damping, simplified = _damped_step(
            system, jacobian, x, correction, damping=damping, norm=norm, settings=settings
        )
        previous = (length * damping, simplified)
        x = x + damping * correction
        if damping == 1.0 and norm(simplified) <= settings.frozen_contraction * length:
            x, taken, last = _simplified_steps(system, jacobian, x, simplified, norm=norm, settings=settings)
            steps += taken
            if last <= settings.tolerance:
                return NewtonSolution(x, jacobians, steps, last)
            previous = None
    raise ForwardModelError(
        "newton_maxit",
        f"no convergence within {settings.maximum_jacobians} Jacobians (last correction {length:.2g})",
        {"last_correction": length},
    )


def _damped_step(
    system: System,
    jacobian: LinearSolver,
    x: Vector,
    correction: Vector,
    *,
    damping: float,
    norm: Callable[[Vector], float],
    settings: NewtonSettings,
) -> tuple[float, Vector]:
    """Return the accepted damping factor and the simplified correction it leaves."""
    length = norm(correction)
    while damping >= settings.smallest_damping:
        try:
            simplified = -jacobian.solve(system.residual(x + damping * correction))
        except ForwardModelError:
            damping *= 0.5
            continue
        if norm(simplified) <= (1.0 - 0.25 * damping) * length:
            return damping, simplified
        curvature = norm(simplified - (1.0 - damping) * correction)
        damping = min(0.5 * damping, 0.5 * length * damping**2 / curvature)
    raise ForwardModelError(
        "newton_stalled",
        f"Newton's steps became shorter than {settings.smallest_damping:g} of the correction ({length:.2g})",
        {"last_correction": length},
    )


def _simplified_steps(
    system: System,
    jacobian: LinearSolver,
    x: Vector,
    correction: Vector,
    *,
    norm: Callable[[Vector], float],
    settings: NewtonSettings,
) -> tuple[Vector, int, float]:
    """Go on with the same Jacobian while it contracts well; return the point, steps taken and last correction."""
    taken, length = 0, norm(correction)
    while True:
        x = x + correction
        taken += 1
        if length <= settings.tolerance:
            return x, taken, length
        correction = -jacobian.solve(system.residual(x))
        shorter = norm(correction)
        if shorter > settings.frozen_contraction * length:
            return x, taken, shorter if shorter > settings.tolerance else length
        length = shorter


def _predicted_damping(correction: Vector, *, norm: Callable[[Vector], float], previous: tuple[float, Vector]) -> float:
    """Return Deuflhard's a-priori damping factor (3.49) from the last step taken and the correction it left."""
    step, simplified = previous
    difference = norm(simplified - correction) * norm(correction)
    if difference == 0.0:
        return 1.0
    return float(min(1.0, max(0.1, step * norm(simplified) / difference)))
