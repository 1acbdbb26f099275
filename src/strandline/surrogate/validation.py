"""Leave-one-out validation in closed form."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from strandline.numerics.linear_algebra import invert
from strandline.surrogate.gaussian_process import GaussianProcess

__all__ = ["NEAR_MODE_COUNT", "NEAR_MODE_WINDOW", "Validation", "validate"]

NEAR_MODE_WINDOW = 10.0
NEAR_MODE_COUNT = 10


@dataclass(frozen=True, eq=False)
class Validation:
    """How well each training run is predicted from all others, hyperparameters and centring fixed.

    Near the mode are the runs whose target lies within `NEAR_MODE_WINDOW` of the largest one, and always the
    `NEAR_MODE_COUNT` best.

    Args:
        residuals: target minus its leave-one-out prediction.
        standardised_residuals: residuals over their predictive standard deviation (with the nugget).
        near_mode: which runs lie near the mode.
        loo_rms: root mean square of the residuals.
        loo_rms_near_mode: the same near the mode: the error that a posterior feels.
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
    residuals, standardised = gp.alpha / precision, gp.alpha / np.sqrt(precision)
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
