"""Correction of a posterior by importance weights at some of its draws, and the choice of these draws."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from strandline.errors import InvalidInput
from strandline.posterior.pareto_smoothing import SmoothedWeights, pareto_smoothed
from strandline.posterior.weighted import Weighted

__all__ = ["Reweighting", "reweight", "subset"]


@dataclass(frozen=True, eq=False)
class Reweighting:
    """Moments of draws of equal weight and of the same draws reweighted, and their difference; each (dim,).

    Args:
        smoothed: Smoothed weights of the draws.
        mean: Mean of the draws.
        sd: Standard deviation of the draws.
        reweighted_mean: Mean under the weights.
        reweighted_sd: Standard deviation under the weights.
        shift: Shift of the mean, in `sd`; both means use the same draws, so their common noise cancels.
        shift_error: Standard error of `shift`, to first order in the influence of each draw.
    """

    smoothed: SmoothedWeights
    mean: Float[np.ndarray, " dim"]
    sd: Float[np.ndarray, " dim"]
    reweighted_mean: Float[np.ndarray, " dim"]
    reweighted_sd: Float[np.ndarray, " dim"]
    shift: Float[np.ndarray, " dim"]
    shift_error: Float[np.ndarray, " dim"]

    @property
    def sd_ratio(self) -> Float[np.ndarray, " dim"]:
        """Reweighted standard deviations divided by those of the draws (dim,)."""
        return np.asarray(self.reweighted_sd / self.sd)


def reweight(draws: Float[np.ndarray, "draw dim"], log_ratios: Float[np.ndarray, " draw"]) -> Reweighting:
    """Return the effect of Pareto-smoothed importance weights on draws of equal weight.

    Args:
        draws: Draws (draw, dim) of the proposal, e.g. a surrogate's posterior.
        log_ratios: Logarithm of target/proposal at each draw, up to a constant; -inf marks a draw that the target
            excludes.

    Raises:
        InvalidInput: Draws that are all the same in one input; or as for `pareto_smoothed`.
    """
    _require_spread(draws)
    smoothed = pareto_smoothed(log_ratios)
    equal = np.full(len(draws), 1 / len(draws))
    before, after = Weighted(draws, equal), Weighted(draws, smoothed.weights)
    mean, sd = before.mean, before.sd
    z, shift = (draws - mean) / sd, (after.mean - mean) / sd
    influence = smoothed.weights[:, None] * (z - shift) - equal[:, None] * (z + 0.5 * shift * (z**2 - 1))
    error = np.sqrt(np.sum(influence**2, axis=0))
    return Reweighting(smoothed, mean, sd, after.mean, after.sd, shift, error)


def subset(weights: Float[np.ndarray, " particle"], number: int, seed: int) -> Int[np.ndarray, " draw"]:
    """Return the indices of `number` particles, ascending: equal strides through the cumulative weights.

    The draws have equal weight. The seed fixes one of the positions, whatever the number: twice as many draws contain
    the first ones.
    """
    phase = np.random.default_rng([seed, 2]).random()
    places = np.sort((phase + np.arange(number) / number) % 1.0)
    cumulative = np.cumsum(weights)
    found = np.searchsorted(cumulative, places * cumulative[-1], side="right")
    return np.asarray(np.minimum(found, np.flatnonzero(weights)[-1]))


def _require_spread(draws: Float[np.ndarray, "draw dim"]) -> None:
    if not np.ptp(draws, axis=0).all():
        raise InvalidInput(
            "draws to be reweighted",
            value="the same value of an input in every draw",
            expected="draws that differ",
            remedy="Take more draws, or look at what the sampler did.",
        )
