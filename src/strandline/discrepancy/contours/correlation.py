"""How the errors of neighbouring points are related: their variance, and their level at low frequencies.

Errors at equal steps h along an outline have the autocovariance c(k), the variance s² = c(0) and the correlation length
ℓ = ∫₀^∞ ρ dt = ½ h Σ c(k) / s². Their level at low frequencies, S = Σ c(k) = 2s²ℓ/h over all lags, is what limits how
well inputs can be known.

Residuals are such errors without something smooth that was removed from them, such as a shift or their own smoothed
course. If that is smooth over lengths well above ℓ, it takes S q(k) from c(k), with q known from what was removed.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

__all__ = ["Correlated", "autocovariance", "restored"]

MOST_REMOVED = 0.5
"""Share of the level that the removed part may have taken from the lags that are added up."""
CLEARLY = 0.2
"""Correlation at the lag after these from which errors count as correlated over more than they span."""


@dataclass(frozen=True)
class Correlated:
    """Errors at equal steps along an outline.

    Args:
        variance: Their variance s², mm².
        level: Their level at low frequencies S = 2s²ℓ/h, at least s², mm².
        cut: Whether they are still clearly correlated at the first lag that could not be added up.
    """

    variance: float
    level: float
    cut: bool

    def length(self, step: float) -> float:
        """Return the correlation length ℓ for steps of this length h, mm; at least h/2, that of independent points."""
        return 0.5 * step * self.level / self.variance


def autocovariance(values: Float[np.ndarray, "row place"], *, closed: bool) -> Float[np.ndarray, " lag"]:
    """Return the mean of v_i v_{i+k} over rows and places, for lags k up to a quarter of the places."""
    number = values.shape[1]
    if closed:
        return np.array([float(np.mean(values * np.roll(values, -k, axis=1))) for k in range(number // 4 + 1)])
    return np.array([float(np.mean(values[:, : number - k] * values[:, k:])) for k in range(number // 4 + 1)])


def restored(covariance: Float[np.ndarray, " lag"], removed: Float[np.ndarray, " lag"]) -> Correlated:
    """Return variance and level of errors from the autocovariance of their residuals.

    c(k) + S q(k) is added up to its first zero, or to where the removed part has taken half. S is in this sum too; it
    grows with every lag at which the sum's new term is above 0, so one pass finds both.

    Args:
        covariance: Autocovariance of the residuals, mm², which differ from 0.
        removed: Factors q(k) of what was removed from the errors; 0 if nothing was.
    """
    sums = covariance[0] + 2 * np.concatenate([[0.0], np.cumsum(covariance[1:])])
    shares = removed[0] + 2 * np.concatenate([[0.0], np.cumsum(removed[1:])])
    k, level = 0, float(sums[0] / (1 - shares[0]))

    def at(lag: int) -> float:
        return float(covariance[lag] + level * removed[lag])

    while k + 1 < len(covariance) and shares[k + 1] <= MOST_REMOVED and at(k + 1) > 0:
        k += 1
        level = float(sums[k] / (1 - shares[k]))
    return Correlated(at(0), level, at(min(k + 1, len(covariance) - 1)) > CLEARLY * at(0))
