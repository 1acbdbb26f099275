"""How one observed interface is compared: by which measure, and with which noise.

An observation states either the noise of a measure, such as a variance σ_N², or the errors of its points. Of the
latter follow the noise of each measure and, for a measure that can use it, the covariance of its residuals.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from strandline.discrepancy import AdaptsToErrors, Discrepancy, Whitens
from strandline.discrepancy.normal_offset import WhitenedOffset
from strandline.discrepancy.protocol import MeasureKey, Snapshot
from strandline.interface import GaussianNoise, Noise, Observation, PointErrors, UnknownErrors
from strandline.likelihood.noise_rule import noise_variance
from strandline.likelihood.registered import Registered, curvature_inverse

__all__ = ["Compared", "FittedErrors", "WhitenedNoise", "adapted", "compared", "errors_of", "with_variance"]


@dataclass(frozen=True)
class WhitenedNoise:
    """Noise of residuals whose covariance is in d² already: log L = -½ d².

    Args:
        log_det: Logarithm of the determinant of their covariance C, in mm².
    """

    log_det: float

    @property
    def scale(self) -> float:
        """1."""
        return 1.0

    @property
    def facts(self) -> dict[str, float]:
        """σ_N² = 1."""
        return {"noise_variance": 1.0}

    def log_density(self, squared: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return -½ d²."""
        return np.asarray(-0.5 * squared)

    def constant(self, terms: int) -> float:
        """Return -½ (n log 2π + log det C)."""
        return -0.5 * (terms * math.log(2 * math.pi) + self.log_det)


@dataclass(frozen=True, eq=False)
class FittedErrors(PointErrors):
    """Errors of points for which the noise of one measure is known, and taken for similar observations too.

    Args:
        variance: σ_N² for the local errors, in the unit of d².
        inverse: (H + 2I)⁻¹ of the global errors, see `Registered`.
    """

    variance: float = 1.0
    inverse: Float[np.ndarray, "error error"] | None = None

    @property
    def facts(self) -> dict[str, float]:
        """The parameters by name, lengths in mm, and σ_N²."""
        return {**super().facts, "noise_variance": self.variance}


@dataclass(frozen=True, eq=False)
class Compared:
    """An observation with the measure and the noise that turn a simulated interface into a log-likelihood."""

    observation: Observation
    measure: Discrepancy
    noise: Noise


def errors_of(observation: Observation) -> PointErrors | None:
    """Return the errors of the observed points, a first guess if they are unknown; None if a noise model is stated."""
    errors = observation.noise
    if isinstance(errors, UnknownErrors):
        return errors.typical(observation.interface)
    return errors if isinstance(errors, PointErrors) else None


def with_variance(observation: Observation, measure: Discrepancy, nodes: int) -> Noise | PointErrors | UnknownErrors:
    """Return the noise of an observation such that σ_N² is not computed again for others like it."""
    noise = observation.noise
    if not isinstance(noise, PointErrors) or isinstance(noise, FittedErrors) or isinstance(measure, Whitens):
        return noise
    return _fitted(observation, measure, nodes)


def _fitted(observation: Observation, measure: Discrepancy, nodes: int) -> FittedErrors:
    errors = errors_of(observation)
    assert errors is not None
    return _kept(MeasureKey.of(adapted(measure, observation)), Snapshot.of(observation.interface), errors, nodes)


@lru_cache(maxsize=64)
def _kept(key: MeasureKey, snapshot: Snapshot, errors: PointErrors, nodes: int) -> FittedErrors:
    seen = snapshot.interface
    variance = noise_variance(key.measure, seen, errors, nodes)
    several = errors.global_errors(seen.dim) > 0
    inverse = curvature_inverse(key.measure, variance, errors, seen, nodes) if several else None
    return FittedErrors(**vars(errors), variance=variance, inverse=inverse)


def adapted(measure: Discrepancy, observation: Observation) -> Discrepancy:
    """Return the measure with options that suit the errors of the observed points, but for those that the user set."""
    errors = errors_of(observation)
    return measure.adapted(errors) if isinstance(measure, AdaptsToErrors) else measure


def compared(observation: Observation, measure: Discrepancy, nodes: int) -> Compared:
    """Return how an observation is compared with simulated interfaces that have this number of nodes.

    Unknown errors are replaced by a first guess; `infer_noise` infers them.

    Raises:
        InvalidInput: The errors of the points are stated, and no noise variance of the measure fits them.
    """
    errors, seen = errors_of(observation), observation.interface
    if errors is None:
        assert not isinstance(observation.noise, PointErrors | UnknownErrors)
        return Compared(observation, measure, observation.noise)
    if not isinstance(measure, Whitens):
        fitted = errors if isinstance(errors, FittedErrors) else _fitted(observation, measure, nodes)
        measure = adapted(measure, observation)
        if fitted.inverse is None:
            return Compared(observation, measure, GaussianNoise(fitted.variance))
        registered = Registered(measure, fitted.variance, errors, fitted.inverse)
        return Compared(observation, registered, WhitenedNoise(0.0))
    whitened = measure.whitened(errors)
    log_det = whitened.model(seen).log_det if isinstance(whitened, WhitenedOffset) else 0.0
    return Compared(observation, whitened, WhitenedNoise(log_det))
