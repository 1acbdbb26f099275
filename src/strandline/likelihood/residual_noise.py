"""The noise of residuals along an observed interface: what it is, and what the observation says that it is.

Errors with standard deviation s and correlation length ℓ have the spectral density 2 s²ℓ at low frequencies, which
decides how well slow shapes are known. Residuals of a model that is right have about the s²ℓ that was stated; if theirs
is several times as large, the model or the measurement has errors that nobody stated.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import pdist

from strandline.discrepancy import Discrepancy, KnowsPointErrors, independent_terms, unit_of
from strandline.interface import (
    Interface,
    Observation,
    PointErrors,
    UnknownErrors,
    arc_lengths,
    spacings,
    steady_lengths,
)
from strandline.likelihood.compared import errors_of
from strandline.likelihood.noise_rule import noise_variance

__all__ = ["ResidualNoise", "StatedErrors", "noise_of_residuals", "noise_on_surface", "stated_errors"]

FEW_DRAWS = 20
"""Drawn observations for an assumed standard deviation: it is known to 8 %."""
MOST = 1500
"""Most points of a surface between which distances are taken."""
_SMALL = 0.1
"""Standard deviation for which the noise variance of a measure is computed, in spacings of the observed points."""


@dataclass(frozen=True)
class ResidualNoise:
    """Standard deviation s and integral correlation length ℓ of residuals along an interface, mm."""

    sd: float
    length: float

    @property
    def level(self) -> float:
        """The product s²ℓ, mm³: half the spectral density at low frequencies."""
        return self.sd**2 * self.length


@dataclass(frozen=True)
class StatedErrors:
    """Errors of the observed points.

    Args:
        errors: The errors.
        assumed: Whether only the noise of the measure was stated, so that independent errors of the points with the
            same noise variance stand for it.
    """

    errors: PointErrors
    assumed: bool

    def noise_along(self, seen: Interface) -> ResidualNoise:
        """Return the standard deviation and the correlation length that residuals of a right model have."""
        return ResidualNoise(self.errors.sd, self.errors.effective_length(seen))


def stated_errors(observation: Observation, measure: Discrepancy, nodes: int) -> StatedErrors:
    """Return the errors of the observed points that the noise of an observation stands for.

    If it states the noise of the measure only, these are independent errors of all coordinates, with the standard
    deviation for which the measure has that noise variance.

    Args:
        observation: The observed interface with its noise.
        measure: The measure d².
        nodes: Number of nodes of the simulated interfaces.

    Raises:
        InvalidInput: No errors of points have a noise variance of this measure.
    """
    stated, known = observation.noise, errors_of(observation)
    if known is not None:
        return StatedErrors(known, assumed=False)
    assert not isinstance(stated, PointErrors | UnknownErrors)
    return StatedErrors(PointErrors(_sd_of_points(stated.scale, measure, observation.interface, nodes)), assumed=True)


def _sd_of_points(variance: float, measure: Discrepancy, seen: Interface, nodes: int) -> float:
    """Return the standard deviation of points, mm, whose noise variance is this one; it grows with its square."""
    if independent_terms(measure, seen) is not None and unit_of(measure, seen) == "mm²":
        return math.sqrt(variance)
    spacing = float(np.median(spacings(seen)))
    small = PointErrors(_SMALL * (spacing if seen.dim == 2 else math.sqrt(spacing)))
    found = measure.noise_variance(small, seen) if isinstance(measure, KnowsPointErrors) else None
    if found is None:
        found = noise_variance(measure, seen, small, nodes, draws=FEW_DRAWS)
    return small.sd * math.sqrt(variance / found)


def noise_of_residuals(residuals: Float[np.ndarray, " point"], polyline: Interface) -> ResidualNoise:
    """Return the standard deviation about zero and the integral correlation length of residuals at the points, mm.

    The autocorrelation of the residuals at equally spaced places is summed up to its first zero: ℓ = h (½ + Σ ρ), at
    least half the spacing h, which is the length of independent residuals.
    """
    places, order = arc_lengths(polyline), np.argsort(arc_lengths(polyline), kind="stable")
    number, whole = len(places), float(steady_lengths(polyline).sum())
    spacing = whole / (number if polyline.closed else number - 1)
    period = whole if polyline.closed else None
    values = np.interp(spacing * np.arange(number), places[order], residuals[order], period=period)
    size = number if polyline.closed else 2 * number  # zeros keep the ends of an open one apart
    products = np.fft.irfft(np.abs(np.fft.rfft(values, size)) ** 2, size)[: size // 2]
    if not products[0] > 0:
        return ResidualNoise(0.0, 0.5 * spacing)
    below = np.flatnonzero(products <= 0)
    last = int(below[0]) if below.size else len(products)
    length = spacing * (0.5 + float(products[1:last].sum() / products[0]))
    return ResidualNoise(math.sqrt(float(np.mean(residuals**2))), length)


def noise_on_surface(residuals: Float[np.ndarray, " point"], surface: Interface) -> ResidualNoise:
    """Return the standard deviation about zero and the integral correlation length of residuals on a surface, mm.

    The covariance of two residuals is averaged over pairs at about the same distance in space, in steps of the spacing
    h, and summed up to its first zero: ℓ = h (½ + Σ ρ). Of many points, every second or third is taken.
    """
    step = -(-len(residuals) // MOST)
    values, points = residuals[::step], surface.points[::step]
    square, h = float(np.mean(values**2)), math.sqrt(float(surface.areas.sum()) / len(values))
    if not square > 0:
        return ResidualNoise(0.0, 0.5 * h)
    which = np.rint(pdist(points) / h).astype(int)
    first, second = np.triu_indices(len(values), 1)
    number = np.maximum(np.bincount(which), 1)
    covariance = np.bincount(which, values[first] * values[second]) / number
    below = np.flatnonzero(covariance[1:] <= 0)
    last = 1 + int(below[0]) if below.size else len(covariance)
    length = h * (0.5 + float(covariance[1:last].sum()) / square)
    return ResidualNoise(math.sqrt(float(np.mean(residuals**2))), length)
