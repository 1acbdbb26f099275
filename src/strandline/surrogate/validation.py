"""Validation of a surrogate: leaving out one run, in closed form, or a tenth of the runs at a time."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from strandline.numerics.linear_algebra import invert
from strandline.surrogate.gaussian_process import GaussianProcess
from strandline.surrogate.predictor import Predictor

__all__ = ["NEAR_MODE_COUNT", "NEAR_MODE_WINDOW", "Validation", "cross_validate", "validate"]

NEAR_MODE_WINDOW = 10.0
NEAR_MODE_COUNT = 10
FOLDS = 10


@dataclass(frozen=True, eq=False)
class Validation:
    """How well each training run is predicted from others that do not include it.

    For a Gaussian process these are all others, with hyperparameters and centring fixed; else nine tenths of the runs.

    Runs near the mode are those whose target lies within `NEAR_MODE_WINDOW` of the largest one, and always the
    `NEAR_MODE_COUNT` best.

    Args:
        residuals: target minus its leave-one-out prediction.
        standardised_residuals: residuals over their predictive standard deviation (with the nugget).
        near_mode: which runs lie near the mode.
        loo_rms: root mean square of the residuals.
        loo_rms_near_mode: the same near the mode: the error that affects a posterior.
        near_mode_count: number of runs near the mode.
        standardised_rms: root mean square of the standardised residuals; near 1 if the variance is realistic.
        standardised_rms_near_mode: the same near the mode.
    """

    residuals: Float[np.ndarray, " run"]
    standardised_residuals: Float[np.ndarray, " run"]
    near_mode: Bool[np.ndarray, " run"]
    loo_rms: float
    loo_rms_near_mode: float
    near_mode_count: int
    standardised_rms: float
    standardised_rms_near_mode: float


def validate(gp: GaussianProcess, y: Float[np.ndarray, " run"]) -> Validation:
    """Return the leave-one-out residuals r_i = α_i / (K⁻¹)_ii of `gp`, whose training targets were `y`."""
    inverse = gp.cholesky.copy(order="F")
    invert(inverse)
    precision = np.diagonal(inverse)
    return _validation(gp.alpha / precision, gp.alpha / np.sqrt(precision), y)


def cross_validate(
    fit: Callable[[Float[np.ndarray, "run dim"], Float[np.ndarray, " run"]], Predictor],
    x: Float[np.ndarray, "run dim"],
    y: Float[np.ndarray, " run"],
) -> Validation:
    """Return the residuals of every tenth run, learnt from the others, for all ten tenths."""
    residuals, variances = np.empty(len(y)), np.empty(len(y))
    for k in range(min(FOLDS, len(y))):
        left_out = np.arange(len(y)) % FOLDS == k
        learnt = fit(x[~left_out], y[~left_out])
        residuals[left_out] = y[left_out] - learnt.mean(x[left_out])
        variances[left_out] = learnt.variance(x[left_out])
    return _validation(residuals, residuals / np.sqrt(np.maximum(variances, np.finfo(float).tiny)), y)


def _validation(
    residuals: Float[np.ndarray, " run"], standardised: Float[np.ndarray, " run"], y: Float[np.ndarray, " run"]
) -> Validation:
    near = _near_mode(y)
    return Validation(
        residuals=residuals,
        standardised_residuals=standardised,
        near_mode=near,
        loo_rms=_rms(residuals),
        loo_rms_near_mode=_rms(residuals[near]),
        near_mode_count=int(near.sum()),
        standardised_rms=_rms(standardised),
        standardised_rms_near_mode=_rms(standardised[near]),
    )


def _near_mode(y: Float[np.ndarray, " run"]) -> Bool[np.ndarray, " run"]:
    tenth_best = np.sort(y)[-min(NEAR_MODE_COUNT, len(y))]
    return np.asarray(y >= min(tenth_best, y.max() - NEAR_MODE_WINDOW))


def _rms(values: Float[np.ndarray, " value"]) -> float:
    return float(np.sqrt(np.mean(values**2)))
