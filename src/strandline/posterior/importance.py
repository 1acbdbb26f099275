"""Importance weights, and their Pareto smoothing: it tames the largest ones and reports whether they dominate.

Vehtari, Simpson, Gelman, Yao, Gabry: Pareto smoothed importance sampling, JMLR 25 (72), 2024. The generalised Pareto
distribution is fitted as in Zhang, Stephens: A new and efficient estimation method for the generalized Pareto
distribution, Technometrics 51 (3), 2009.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from scipy.special import logsumexp

from strandline.foundations import require
from strandline.posterior.weighted import Weighted

Verdict = Literal["good", "usable", "bad"]
GOOD_BELOW, USABLE_BELOW = 0.5, 0.7
NEARLY_EQUAL = 0.98
"""Share of effective draws from which the weights change nothing, whatever the shape of their tail."""
SMALLEST_TAIL = 5
PRIOR_SHAPE, PRIOR_WEIGHT = 0.5, 10
"""The shape is shrunk towards 1/2 with the weight of ten observations: Appendix C of Vehtari et al."""
USUAL, USUAL_SETS, INTERQUARTILE_RANGE = 0.99, 400, 1.349
"""Share of sets of normal log ratios whose k̂ is usual; number of sets tried; range of the standard normal."""
LOG_NOTHING = -460.0  # a weight below e^-460 = 1e-200 of the largest counts as zero
LOG_EQUAL = 1e-10
"""If the largest log weights differ by less than this, they are equal except for rounding and have no tail."""


@dataclass(frozen=True)
class GeneralisedPareto:
    """The distribution on x > 0 with survival function (1 + k x/σ)^(-1/k), k = `shape` and σ = `scale`.

    For k > 0 its tail follows a power law, and only moments below 1/k exist.
    """

    shape: float
    scale: float

    def quantile(self, p: Float[np.ndarray, " level"]) -> Float[np.ndarray, " level"]:
        """Return the quantiles at the probabilities `p`."""
        exponential = -np.log1p(-p)
        if abs(self.shape) < 1e-12:
            return np.asarray(self.scale * exponential)
        return np.asarray(self.scale * np.expm1(self.shape * exponential) / self.shape)


@dataclass(frozen=True, eq=False)
class SmoothedWeights:
    """Normalised log weights (draw,), and the shape k̂ of the raw weights' tail.

    k̂ is -inf if the largest weights are equal, so that there is no tail, and +inf if fewer than five weights stand
    out, so that none can be fitted.
    """

    log_weights: Float[np.ndarray, " draw"]
    k_hat: float

    @property
    def weights(self) -> Float[np.ndarray, " draw"]:
        """Normalised weights (draw,)."""
        return np.asarray(np.exp(self.log_weights))

    @property
    def ess(self) -> float:
        """Effective sample size of the weights, 1 / Σ w²."""
        return float(1.0 / np.sum(self.weights**2))


def pareto_smoothed(log_ratios: Float[np.ndarray, " draw"]) -> SmoothedWeights:
    """Return the smoothed weights of draws from a proposal, given log(target/proposal) at each, up to a constant.

    The largest min(S/5, 3√S) of the S ratios are replaced by the quantiles of a generalised Pareto distribution fitted
    to them, none above the largest raw one. A ratio of -inf marks a draw without weight, which counts among the S.

    Raises:
        InvalidInput: fewer than five draws, a ratio that is NaN or +inf, or none that is finite.
    """
    number, undefined = len(log_ratios), np.isnan(log_ratios) | np.isposinf(log_ratios)
    right = number >= SMALLEST_TAIL and not undefined.any() and not np.isneginf(log_ratios).all()
    value = f"{number} values, {np.isfinite(log_ratios).sum()} of them finite"
    words = f"at least {SMALLEST_TAIL}, finite or -inf, and not all -inf", "Check both log densities at the draws."
    require(right, "log ratios of importance sampling", value, *words)
    log_weights = log_ratios - log_ratios.max()
    order = np.argsort(log_weights, kind="stable")
    length = max(SMALLEST_TAIL, math.ceil(min(number / 5, 3 * math.sqrt(number))))
    cutoff = max(float(log_weights[order[-min(length + 1, number)]]), LOG_NOTHING)
    if -cutoff <= LOG_EQUAL:
        return SmoothedWeights(log_weights - logsumexp(log_weights), -math.inf)
    tail = order[log_weights[order] > cutoff]
    if len(tail) < SMALLEST_TAIL:
        return SmoothedWeights(log_weights - logsumexp(log_weights), math.inf)
    fitted = fit_generalised_pareto(np.exp(log_weights[tail]) - math.exp(cutoff))
    shape = (len(tail) * fitted.shape + PRIOR_WEIGHT * PRIOR_SHAPE) / (len(tail) + PRIOR_WEIGHT)
    levels = (np.arange(len(tail)) + 0.5) / len(tail)
    smooth = GeneralisedPareto(shape, fitted.scale).quantile(levels) + math.exp(cutoff)
    log_weights[tail] = np.minimum(np.log(smooth), 0.0)
    return SmoothedWeights(log_weights - logsumexp(log_weights), shape)


def fit_generalised_pareto(exceedances: Float[np.ndarray, " tail"]) -> GeneralisedPareto:
    """Return the distribution fitted to `exceedances`, which are all above 0 and ascending.

    Zhang and Stephens (2009): the posterior mean of θ = -k/σ under a weak prior, on a grid of quantiles of that prior,
    with the likelihood maximised over k at each.
    """
    x, number = exceedances, len(exceedances)
    size = 30 + math.isqrt(number)
    quarter = float(x[max(int(number / 4 + 0.5) - 1, 0)])
    theta = 1 / x[-1] + (1 - np.sqrt(size / (np.arange(size) + 0.5))) / (3 * quarter)
    shapes = np.mean(np.log1p(-theta[:, None] * x), axis=1)
    profile = number * (np.log(-theta / shapes) - shapes - 1)
    mean = float(np.exp(profile - logsumexp(profile)) @ theta)
    shape = float(np.mean(np.log1p(-mean * x)))
    return GeneralisedPareto(shape, -shape / mean)


def reliability_threshold(number: int) -> float:
    """Return the k̂ above which `number` draws are too few for a reliable estimate, min(1 - 1/log₁₀ S, 0.7)."""
    return min(1 - 1 / math.log10(number), USABLE_BELOW)


def verdict_on(weights: SmoothedWeights) -> Verdict:
    """Return how reliable estimates with these weights are.

    k̂ does not depend on how much the weights differ. If they hardly differ, even a heavy tail moves no estimate: their
    coefficient of variation is √(S / effective draws - 1), below 0.15 from `NEARLY_EQUAL` on.
    """
    number = len(weights.log_weights)
    threshold = reliability_threshold(number)
    if weights.k_hat < min(GOOD_BELOW, threshold) or weights.ess >= NEARLY_EQUAL * number:
        return "good"
    return "usable" if weights.k_hat < threshold else "bad"


def largest_usual_k_hat(log_ratios: Float[np.ndarray, " draw"]) -> float:
    """Return the k̂ that 99 % of sets of as many normal log ratios with the same interquartile range do not exceed.

    A few dozen draws leave k̂ so uncertain that it is often above 1/2 for weights without a heavy tail. The logarithms
    of the weights are known up to a constant; -inf marks a draw without weight.
    """
    finite = log_ratios[np.isfinite(log_ratios)]
    spread = float(np.diff(np.quantile(finite, [0.25, 0.75]))[0]) / INTERQUARTILE_RANGE
    return _usual_k_hat(len(log_ratios), max(round(spread, 2), 0.01))


@lru_cache(maxsize=64)
def _usual_k_hat(number: int, spread: float) -> float:
    sets = spread * np.random.default_rng(0).standard_normal((USUAL_SETS, number))
    return float(np.quantile([pareto_smoothed(one).k_hat for one in sets], USUAL, method="higher"))


@dataclass(frozen=True, eq=False)
class Reweighting:
    """Moments of draws of equal weight and of the same draws reweighted, and their difference; each (dim,).

    `shift` is that of the mean, in `sd`; both means use the same draws, so their common noise cancels. `shift_error` is
    its standard error, to first order in the influence of each draw.
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
    """Return the effect of Pareto-smoothed importance weights on draws of equal weight, e.g. of a surrogate's
    posterior.

    `log_ratios` are logarithms of target/proposal at each draw, up to a constant; -inf marks a draw that the target
    excludes.

    Raises:
        InvalidInput: Draws that are all the same in one input; or as for `pareto_smoothed`.
    """
    value, remedy = "the same value of an input in every draw", "Take more draws, or look at what the sampler did."
    require(np.ptp(draws, axis=0).all(), "draws to be reweighted", value, "draws that differ", remedy)
    smoothed = pareto_smoothed(log_ratios)
    before, after = Weighted(draws, np.full(len(draws), 1 / len(draws))), Weighted(draws, smoothed.weights)
    shift, old, new = shifted(before, after)
    error = np.sqrt(np.sum((new - old) ** 2, axis=0))
    return Reweighting(smoothed, before.mean, before.sd, after.mean, after.sd, shift, error)


def shifted(
    before: Weighted, after: Weighted
) -> tuple[Float[np.ndarray, " dim"], Float[np.ndarray, "old dim"], Float[np.ndarray, "new dim"]]:
    """Return the shift of the mean in standard deviations before, and the influence of each old and new draw on it."""
    mean, sd = before.mean, before.sd
    z, shift = (before.draws - mean) / sd, (after.mean - mean) / sd
    old = before.weights[:, None] * (z + 0.5 * shift * (z**2 - 1))
    return shift, old, after.weights[:, None] * ((after.draws - mean) / sd - shift)


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
