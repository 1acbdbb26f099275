"""A measure whose observation may be shifted, turned, scaled or offset by a little: these errors are integrated out.

With g the global errors in their standard deviations, the likelihood is ∫ exp(-½ d²(g)/σ_N²) N(g; 0, I) dg. Signed
distances of the observed points tell the most probable g₀ for each simulated interface, which follows the observation
by it. For small h = g₀ - g, d²(h)/σ_N² = f + bᵀh + ½ hᵀHh, so that the integral is, but for a constant,

    exp(-½ [f + |g₀|² - ½ (b - 2g₀)ᵀ (H + 2I)⁻¹ (b - 2g₀)]).

b comes from the observation moved ahead and behind by h; H hardly changes and is computed once.
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


@dataclass(frozen=True, eq=False)
class Registered:
    """d²/σ_N² with the global errors of the observation integrated out; without a unit.

    Each evaluation takes 1 + 2k evaluations of the measure; k, the number of global errors, is up to five in the plane.

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
        number, middle = self.errors.global_errors(observed.dim), observed.points.mean(axis=0)
        g = WhitenedOffset(self.errors).global_errors(points, template, observed)
        points = self.errors.followed(points, template, g, middle=middle)
        moves = STEP * differences(number)[: 1 + 2 * number]
        moved = [self.errors.moved(observed, by) for by in moves]
        here, *others = [squared_discrepancies(self.measure, points, template, one) / self.variance for one in moved]
        slopes = (np.array(others[:number]) - np.array(others[number:])).T / (2 * STEP) - 2 * g
        left = here + (g**2).sum(axis=1) - 0.5 * ((slopes @ self.inverse) * slopes).sum(axis=1)
        return np.asarray(np.maximum(left, 0.0))


def curvature_inverse(
    measure: Discrepancy, variance: float, errors: PointErrors, observed: Interface, nodes: int
) -> Float[np.ndarray, "error error"]:
    """Return (H + 2I)⁻¹ at the observation itself, as simulated interfaces with this number of nodes see it."""
    number = errors.global_errors(observed.dim)
    template = observed.resampled(nodes) if observed.dim == 2 else observed
    moved = [errors.moved(observed, STEP * by) for by in differences(number)]
    squares = np.array([float(measure(template, one)) for one in moved])
    values, vectors = np.linalg.eigh(second_differences(squares, number) / (variance * STEP**2))
    return np.asarray((vectors / (np.maximum(values, 0.0) + 2.0)) @ vectors.T)
