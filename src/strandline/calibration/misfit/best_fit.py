"""The inputs that explain the observed points best, and what is left of the residuals when all causes are fitted.

Around these inputs the residuals are linear in the inputs u, scaled by mean and standard deviation of their priors, and
in the errors c of the surrogate's modes, in their standard deviations: r = e + J u + F c with errors e of covariance C.
The most probable u and c are those of a linear Gaussian model with the covariance S = C + JJᵀ + FFᵀ of r.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from strandline.calibration.misfit.prediction import Prediction
from strandline.calibration.misfit.residuals import Residuals
from strandline.interface import ErrorModel
from strandline.parameters import ParameterSpace
from strandline.posterior import Posterior
from strandline.posterior.weighted import Weighted

__all__ = ["BestFit", "best_fit"]

STEPS = 4
"""Largest number of Gauss–Newton steps from the MAP."""
LEVELS = 400
"""Quantiles of the priors from which their moments are computed."""
NEGLIGIBLE = 0.02
"""Standard deviation of a mode of the surrogate, in that of a point, below which it counts as exact."""


@dataclass(frozen=True, eq=False)
class BestFit:
    """The inputs that explain the observed points best.

    Args:
        at: The inputs, shape (dim,).
        scaled: The inputs in standard deviations of their priors from the mean, shape (dim,).
        residuals: Signed distances of the observed points from the prediction there, mm.
        by_inputs: Change of the residuals with each scaled input, J, mm.
        by_modes: Change of the residuals if a mode of the surrogate is off by its standard deviation, F, mm.
    """

    at: Float[np.ndarray, " dim"]
    scaled: Float[np.ndarray, " dim"]
    residuals: Float[np.ndarray, " seen"]
    by_inputs: Float[np.ndarray, "seen scale"]
    by_modes: Float[np.ndarray, "seen mode"]

    @property
    def causes(self) -> Float[np.ndarray, "seen cause"]:
        """J and F side by side."""
        return np.hstack([self.by_inputs, self.by_modes])

    def with_modes(self, model: ErrorModel) -> ErrorModel:
        """Return the covariance C + FFᵀ of the residuals at known inputs."""
        return ErrorModel(model.local, np.hstack([model.shared, self.by_modes]))

    def with_causes(self, model: ErrorModel) -> ErrorModel:
        """Return the covariance S = C + JJᵀ + FFᵀ of the residuals at the priors' means."""
        return ErrorModel(model.local, np.hstack([model.shared, self.causes]))

    def cost(self, model: ErrorModel) -> float:
        """Return rᵀ (C + FFᵀ)⁻¹ r + |u|², twice the negative log density of these inputs."""
        return float(self.with_modes(model).square(self.residuals)) + float(self.scaled @ self.scaled)

    def next(self, model: ErrorModel) -> Float[np.ndarray, " dim"]:
        """Return the scaled inputs of least cost if the residuals are linear: -Jᵀ S⁻¹ (r - J u)."""
        at_means = self.residuals - self.by_inputs @ self.scaled
        return np.asarray(-self.by_inputs.T @ self.with_causes(model).solved(at_means))


def best_fit(residuals: Residuals, prediction: Prediction, posterior: Posterior) -> BestFit:
    """Return the inputs of least cost near the MAP, inside the box, by Gauss–Newton steps.

    If a single run stands for all inputs, this is the MAP, and no input changes the residuals.
    """
    space, prior = posterior.space, _prior(posterior.space)
    best = _around(posterior.map_estimate, residuals, prediction, posterior, prior)
    if prediction.run_alone:
        return replace(best, by_inputs=best.by_inputs[:, :0])
    for _ in range(STEPS):
        x = np.clip(prior.mean + prior.sd * best.next(residuals.model), space.low, space.high)
        moved = _around(x, residuals, prediction, posterior, prior)
        if not moved.cost(residuals.model) < best.cost(residuals.model):
            break
        best = moved
    return best


def _prior(space: ParameterSpace) -> Weighted:
    """Return quantiles of the priors, for their means and standard deviations."""
    p = (np.arange(LEVELS) + 0.5) / LEVELS
    return Weighted(space.prior_quantiles(np.tile(p[:, None], (1, space.dim))), np.full(LEVELS, 1 / LEVELS))


def _around(
    x: Float[np.ndarray, " dim"],
    residuals: Residuals,
    prediction: Prediction,
    posterior: Posterior,
    prior: Weighted,
) -> BestFit:
    """Return the residuals at `x` and their derivatives, by central differences inside the box."""
    space, dim = posterior.space, len(x)
    width = space.high - space.low
    step = np.clip(0.5 * posterior.sd, 1e-4 * width, 0.1 * width)
    ahead, behind = np.minimum(x + step, space.high), np.maximum(x - step, space.low)
    rows, each = np.tile(x, (1 + 2 * dim, 1)), np.arange(dim)
    rows[1 + each, each], rows[1 + dim + each, each] = ahead, behind
    found = residuals.at(prediction.points(rows), prediction.templates)
    difference = np.zeros((dim, found.shape[1])) if prediction.run_alone else found[1 : 1 + dim] - found[1 + dim :]
    least = NEGLIGIBLE * min(one.errors.sd for one in residuals.stated)
    disturbed = residuals.at(prediction.uncertain(x, least), prediction.templates)
    return BestFit(
        at=x,
        scaled=(x - prior.mean) / prior.sd,
        residuals=found[0],
        by_inputs=(prior.sd[:, None] * difference / (ahead - behind)[:, None]).T,
        by_modes=(disturbed - found[0]).T,
    )
