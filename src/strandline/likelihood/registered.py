"""A measure whose observation may be shifted, turned, scaled or offset by a little: these errors are integrated out.

With g the global errors in their standard deviations, the likelihood is ∫ exp(-½ f(g)) dg, f(g) = d²(g)/σ_N² + |g|²,
where the simulated interface has followed the observation by g. Signed distances of the observed points tell a first g,
Newton's steps lead from there to the least f, and the likelihood is exp(-½ min f) but for a constant (Laplace). The
Hessian H of d²/σ_N² hardly changes and is computed once; it also corrects one-sided differences to the second order.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from strandline.discrepancy import Discrepancy, squared_discrepancies
from strandline.discrepancy.normal_offset import WhitenedOffset
from strandline.interface import Interface, PointErrors
from strandline.likelihood.noise_rule import differences, second_differences

__all__ = ["Registered", "curvature_inverse"]

STEP = 0.5
"""Step of the finite differences, in standard deviations of the global errors."""
NEWTON = 2
"""Newton's steps."""


@dataclass(frozen=True, eq=False)
class Registered:
    """d²/σ_N² with the global errors of the observation integrated out; without a unit.

    Each evaluation takes 3 + 2k evaluations of the measure; k, the number of global errors, is up to five in the plane.

    Args:
        measure: The measure d².
        variance: Noise variance σ_N² of the local errors, in its unit.
        errors: Errors of the observed points, of which the global ones count here.
        inverse: (H + 2I)⁻¹, from `curvature_inverse`.
    """

    measure: Discrepancy
    variance: float
    errors: PointErrors
    inverse: Float[np.ndarray, "error error"]
    unit: ClassVar[str] = "1"

    def __call__(self, simulated: Interface, observed: Interface) -> float:
        """Return the value."""
        return float(self._values(simulated.points[None], simulated, observed)[0])

    def many(
        self, points: Float[np.ndarray, "run point xyz"], template: Interface, observed: Interface
    ) -> Float[np.ndarray, " run"]:
        """Return the values of interfaces of the same cells."""
        return self._values(points, template, observed)

    def _values(
        self, points: Float[np.ndarray, "run point xyz"], template: Interface, observed: Interface
    ) -> Float[np.ndarray, " run"]:
        number = self.errors.global_errors(observed.dim)
        middle = observed.points.mean(axis=0)

        def f(g: Float[np.ndarray, "run error"]) -> Float[np.ndarray, " run"]:
            moved = self.errors.followed(points, template, g, middle=middle)
            squares = squared_discrepancies(self.measure, moved, template, observed)
            return np.asarray(squares / self.variance + (g**2).sum(axis=1))

        g = WhitenedOffset(self.errors).global_errors(points, template, observed)
        least = here = f(g)
        bend = 0.5 * STEP * np.diag(np.linalg.inv(self.inverse))
        for _ in range(NEWTON):
            slopes = np.array([(f(g + STEP * e) - here) / STEP for e in np.eye(number)]).T - bend
            g = g - slopes @ self.inverse
            here = f(g)
            least = np.minimum(least, here)
        return np.asarray(least)


def curvature_inverse(
    measure: Discrepancy, variance: float, errors: PointErrors, observed: Interface, nodes: int
) -> Float[np.ndarray, "error error"]:
    """Return (H + 2I)⁻¹ at the observation itself, as simulated interfaces with this number of nodes see it."""
    moves = STEP * differences(errors.global_errors(observed.dim))
    template = observed.resampled(nodes) if observed.dim == 2 else observed
    points = np.repeat(template.points[None], len(moves), axis=0)
    moved = errors.followed(points, template, moves, middle=observed.points.mean(axis=0))
    squares = squared_discrepancies(measure, moved, template, observed)
    values, vectors = np.linalg.eigh(second_differences(squares, moves.shape[1]) / (variance * STEP**2))
    return np.asarray((vectors / (np.maximum(values, 0.0) + 2.0)) @ vectors.T)
