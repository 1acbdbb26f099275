"""Posterior-predictive p-values of the measure itself (Gelman, Meng and Stern 1996).

At each draw θ of the posterior, d² of the observation is compared with d² of an observation drawn at θ. The errors of
an observation do not depend on the inputs, so all of them are drawn on the interface that the best fit predicts. The
posterior has seen the observation: these p-values are conservative, near ½ more often than not.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.calibration.misfit.best_fit import BestFit
from strandline.calibration.misfit.prediction import Prediction
from strandline.calibration.misfit.residuals import Residuals
from strandline.discrepancy import (
    Currents,
    Discrepancy,
    NormalOffset,
    TrackedPoints,
    WhitenedOffset,
    squared_discrepancies,
)
from strandline.discrepancy.nearest import closest_points
from strandline.interface import GaussianNoise, Interface, steady_normals
from strandline.likelihood import Compared, compared
from strandline.likelihood.registered import Registered
from strandline.likelihood.residual_noise import StatedErrors
from strandline.likelihood.shared_errors import shared_errors
from strandline.posterior import Posterior

__all__ = ["PredictiveShares", "predictive_shares"]

FEW_DRAWS = 32
"""Most draws of the posterior for surfaces, which are compared one by one; too few to flag a model."""
SYMMETRIC = (Currents, TrackedPoints)
"""Measures in which both interfaces can change places: many drawn observations are compared at once."""


@dataclass(frozen=True, eq=False)
class PredictiveShares:
    """Shares of posterior draws at which a drawn observation is as far from the prediction as the true one.

    Args:
        whole: Share by the sum over all observations, in units of log-likelihood.
        conditions: Share by each observation alone.
    """

    whole: float
    conditions: tuple[float, ...]


def predictive_shares(
    residuals: Residuals,
    fit: BestFit,
    prediction: Prediction,
    posterior: Posterior,
    random: np.random.Generator,
    most: int,
) -> PredictiveShares:
    """Return the posterior-predictive p-values of d², of all observations and of each, from at most `most` draws."""
    observations, measure, templates = residuals.observations, residuals.measure, prediction.templates
    slow = any(seen.interface.dim == 3 for seen in observations) and not isinstance(measure, NormalOffset)
    draws = min(FEW_DRAWS, most) if slow else most
    points, at_fit = prediction.points(posterior.equally_weighted(random, draws)), prediction.points(fit.at[None])
    noise = residuals.drawn(draws, random)
    fields = random.standard_normal((draws, fit.by_modes.shape[1])) @ fit.by_modes.T
    observed, drawn = [], []
    for seen, stated, part in zip(observations, residuals.stated, residuals.parts, strict=True):
        template = templates[seen.condition]
        how = _plain(compared(seen, measure, len(template.points)))
        predicted = Interface(at_fit[seen.condition][0], template.cells)
        true = squared_discrepancies(how.measure, points[seen.condition], template, seen.interface)
        others = _drawn(how, stated, predicted, noise[:, part], fields[:, part], random)
        observed.append(-2 * how.noise.log_density(true))
        drawn.append(-2 * how.noise.log_density(others))
    both = np.sum(observed, axis=0), np.sum(drawn, axis=0)
    shared = shared_errors(observations, measure)
    if shared is not None:
        both = shared.many(points, templates), shared.model.square(noise + fields)
    return PredictiveShares(_share(*both), tuple(map(_share, observed, drawn)))


def _plain(how: Compared) -> Compared:
    """Return the comparison by the measure itself, in which global errors show: drawn observations contain them too."""
    one = how.measure
    return Compared(how.observation, one.measure, GaussianNoise(one.variance)) if isinstance(one, Registered) else how


def _share(observed: Float[np.ndarray, " #draw"], drawn: Float[np.ndarray, " draw"]) -> float:
    """Return the share of draws in which the drawn value reaches the observed one, one such draw added."""
    return float((1 + np.sum(drawn >= observed)) / (1 + len(drawn)))


def _drawn(
    how: Compared,
    stated: StatedErrors,
    predicted: Interface,
    noise: Float[np.ndarray, "draw point"],
    fields: Float[np.ndarray, "draw point"],
    random: np.random.Generator,
) -> Float[np.ndarray, " draw"]:
    """Return d² of drawn observations, from their residuals alone if the measure depends on nothing else.

    Args:
        how: The observation, and the measure that applies to it.
        stated: Errors of its points.
        predicted: The predicted interface.
        noise: Drawn errors of the points along the normals, mm.
        fields: Drawn errors of the surrogate along the normals, mm.
        random: Generator of the random numbers.
    """
    measure, seen = how.measure, how.observation.interface
    if isinstance(measure, WhitenedOffset):
        return measure.model(seen).square(noise + fields)
    if isinstance(measure, NormalOffset):
        return np.asarray(((noise + fields) ** 2).sum(axis=1))
    points = _without_errors(measure, predicted, seen) + _displacements(seen, stated, len(noise), random)
    if fields.any():
        points += fields[..., None] * steady_normals(seen)
    if isinstance(measure, SYMMETRIC):
        return squared_discrepancies(measure, points, seen, predicted)
    return np.array([measure(predicted, Interface(row, seen.cells)) for row in points], float)


def _without_errors(measure: Discrepancy, predicted: Interface, seen: Interface) -> Float[np.ndarray, "point xyz"]:
    """Return the observed points as a right model predicts them: the closest points, or node by node."""
    return predicted.points if isinstance(measure, TrackedPoints) else closest_points(seen.points, predicted).points


def _displacements(
    seen: Interface, stated: StatedErrors, number: int, random: np.random.Generator
) -> Float[np.ndarray, "draw point xyz"]:
    """Return errors of the observed points, mm: independent ones of all coordinates if only σ_N² is stated."""
    if stated.assumed:
        return stated.errors.sd * random.standard_normal((number, *seen.points.shape))
    return np.asarray([stated.errors.draw(seen, random).points for _ in range(number)] - seen.points)
