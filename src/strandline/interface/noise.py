"""Noise of an observed interface: what turns a discrepancy into a log-likelihood."""

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from strandline.errors import InvalidInput

__all__ = ["NOISES", "GaussianNoise", "Noise"]


@runtime_checkable
class Noise(Protocol):
    """Errors of one observed interface, as a discrepancy d² sees them.

    Nothing else turns d² into a log-likelihood, for runs and for surrogates alike. `strandline.testing.noise` checks
    an implementation.
    """

    @property
    def scale(self) -> float:
        """The d² that costs half a unit of log-likelihood, in the unit of d²; σ_N² for a Gaussian."""
        ...

    @property
    def facts(self) -> dict[str, float]:
        """Its parameters by name, for summary.json and posterior.nc."""
        ...

    def log_density(self, squared: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the log-likelihood of discrepancies d² ≥ 0, without `constant`; 0 at d² = 0, falling from there."""
        ...

    def constant(self, terms: int) -> float:
        """Return the constant that `log_density` omits from the density of `terms` residuals whose squares sum to d².

        With it, that density integrates to 1. It is used to compare models by their evidence if the discrepancy is
        such a sum.
        """
        ...


@dataclass(frozen=True)
class GaussianNoise:
    """Independent Gaussian errors of one variance: log L = -½ d²/σ_N² (Willmann et al. 2022, Eq. 4).

    Args:
        variance: Variance σ_N², in the unit of d².

    Raises:
        InvalidInput: A variance that is not a finite number above 0.
    """

    variance: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.variance) and self.variance > 0):
            raise InvalidInput(
                "noise variance of the observation",
                value=self.variance,
                expected="a finite number above 0, in the unit of the discrepancy d²",
                remedy="Estimate it from the resolution of the measurement.",
            )

    @property
    def scale(self) -> float:
        """Variance σ_N²."""
        return self.variance

    @property
    def facts(self) -> dict[str, float]:
        """The variance."""
        return {"noise_variance": self.variance}

    def log_density(self, squared: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return -½ d²/σ_N²."""
        return np.asarray(-0.5 * squared / self.variance)

    def constant(self, terms: int) -> float:
        """Return -½ n log(2πσ_N²)."""
        return -0.5 * terms * math.log(2 * math.pi * self.variance)


NOISES = {"gaussian": GaussianNoise}
"""Noise models by their names in study files."""
