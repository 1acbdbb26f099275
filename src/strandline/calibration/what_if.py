"""How a posterior changes with its assumptions: by weights of its draws, or by new draws through the surrogate.

The draws of the posterior get the weights p'(x) L'(x) / (p(x) L(x)), with the prior p and the likelihood L of the study
and those of the alternative. The largest weights are smoothed, and their tail decides whether they can be used (Vehtari
et al. 2024). If not, or if the alternative allows inputs where there are no draws, its posterior is sampled again,
through the surrogate of the interface. No forward run is made.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.special import log_softmax, logsumexp

from strandline.calibration.alternative import Alternative, Baseline
from strandline.calibration.importance_sampler import effective_size, importance_or_smc, prior_and_posterior, prior_pool
from strandline.calibration.source import POINTS, FieldQuality, quality_at
from strandline.design import Knowledge
from strandline.posterior import Weighted, pareto_smoothed, reliability_threshold, shifted

LEAST_SHIFT = 0.2
"""Shift of a mean, in present standard deviations, from which an input moves."""
LEAST_RATIO = 1.25
"""Ratio of the standard deviations, or its inverse, from which an input moves."""
FEWEST = 100.0
"""Effective draws that reweighting must leave."""
WIDEST = 1.3
"""Standard deviation, in those of the draws without weights, up to which reweighting is believed. From 1000 draws of a
Gaussian it gives widths of one 1.3, 1.5, 2 times as wide up to 10, 15, 29 % too small (1 in 20 of them more), mostly
with a k̂ that passes."""
ENOUGH = 1000.0
"""Effective draws at which the sampler stops."""
COUNTS = 0.99
"""Share of the weight, on the draws with the largest ones, that gets the likelihood expected over possible fields."""
By = Literal["reweighting", "importance", "smc"]
Points = Float[np.ndarray, "point dim"]
Values = Float[np.ndarray, " point"]


@dataclass(frozen=True, eq=False)
class Answer:
    """The posterior under an alternative, beside the present one.

    `by` and `draws` are None if that takes new runs; `why_not` then says why. `k_hat` is the shape k̂ of the tail of
    the present draws' weights, if they were tried. `log_evidence_change` is None if the data or the measure differ,
    `quality`, how good the surrogate is at the draws, if it was not used.
    """

    alternative: Alternative
    present: Baseline
    by: By | None
    draws: Weighted | None
    k_hat: float
    effective: float
    log_evidence_change: float | None = None
    quality: FieldQuality | None = None
    why_not: str = ""

    def __repr__(self) -> str:
        return f"<Answer to {self.alternative.name}: {self.by or 'needs new runs'}{', moves' if self.moves else ''}>"

    @property
    def shift(self) -> Float[np.ndarray, " dim"]:
        """Shift of the means, in present standard deviations, shape (dim,); NaN without an answer or if fixed."""
        return self._of_draws(lambda draws: (draws.mean - self.present.mean) / self.present.sd)

    @property
    def sd_ratio(self) -> Float[np.ndarray, " dim"]:
        """Standard deviations over the present ones, shape (dim,); NaN likewise."""
        return self._of_draws(lambda draws: draws.sd / self.present.sd)

    @cached_property
    def shift_error(self) -> Float[np.ndarray, " dim"]:
        """Standard error of `shift` from the finite number of draws, to first order; draws in common cancel."""
        return self._of_draws(self._shift_error)

    def _shift_error(self, draws: Weighted) -> Float[np.ndarray, " dim"]:
        _, old, new = shifted(self.present.weighted, draws)
        if self.by == "reweighting":
            return np.asarray(np.sqrt(np.sum((new - old) ** 2, axis=0)))
        return np.asarray(np.sqrt(np.sum(new**2, axis=0) + np.sum(old**2, axis=0)))

    @property
    def moved(self) -> tuple[str, ...]:
        far = (np.abs(self.shift) > LEAST_SHIFT) | (np.abs(np.log(self.sd_ratio)) > math.log(LEAST_RATIO))
        return tuple(name for name, one in zip(self.present.space.names, far, strict=True) if one)

    @property
    def moves(self) -> bool:
        return bool(self.moved)

    @property
    def size(self) -> float:
        """How much the input that moves most does: 1 at the limit of what counts; 0 without an answer."""
        if self.draws is None:
            return 0.0
        shift, width = np.abs(self.shift) / LEAST_SHIFT, np.abs(np.log(self.sd_ratio)) / math.log(LEAST_RATIO)
        return float(np.nanmax([shift, width]))

    def _of_draws(self, figures: Callable[[Weighted], Float[np.ndarray, " dim"]]) -> Float[np.ndarray, " dim"]:
        names, fixed = self.present.space.names, self.alternative.fixed
        found = np.full(len(names), np.nan) if self.draws is None else figures(self.draws)
        return np.where([name in fixed for name in names], np.nan, found)


def reweight_or_resample(now: Baseline, alternative: Alternative, *, seed: int) -> Answer:
    """Return the posterior under an alternative; the seed is for draws, if it is sampled again."""
    k_hat, effective = math.nan, 0.0
    if now.knowledge is None and not alternative.by_prior_alone:
        return Answer(alternative, now, None, None, k_hat, effective, why_not=now.why_not)
    if not alternative.fixed and _covered(now, alternative):
        found = reweighted(now, alternative)
        enough = found.k_hat < reliability_threshold(len(now.draws)) and found.effective >= FEWEST
        if enough and found.draws is not None and (found.draws.sd <= WIDEST * np.std(now.draws, axis=0)).all():
            return _judged(found)
        k_hat, effective = found.k_hat, found.effective
    if now.knowledge is None:
        return Answer(alternative, now, None, None, k_hat, effective, why_not=now.why_not)
    return _judged(_sampled(now, now.knowledge, alternative, k_hat, np.random.default_rng(seed)))


def _judged(answer: Answer) -> Answer:
    """Return the answer, or why there is none: the surrogate is too coarse where its draws are."""
    now, alternative, draws = answer.present, answer.alternative, answer.draws
    if draws is None or now.knowledge is None or (answer.by == "reweighting" and alternative.likelihood is None):
        return answer
    likelihood = alternative.likelihood or now.knowledge.likelihood
    quality = quality_at(likelihood, draws.draws, draws.weights)
    if quality.good:
        return replace(answer, quality=quality)
    why = f"the surrogate of the interface is too coarse at {100 * quality.beyond:.0f} % of its draws"
    return replace(answer, by=None, draws=None, log_evidence_change=None, quality=quality, why_not=why)


def _covered(now: Baseline, alternative: Alternative) -> bool:
    """Return whether the alternative allows inputs only where the present prior does."""
    for old, new in zip(now.space, alternative.space, strict=True):
        (low, high), (least, most) = old.truncated_prior.support, new.truncated_prior.support
        slack = 1e-9 * (high - low)
        if least < low - slack or most > high + slack:
            return False
    return True


def reweighted(now: Baseline, alternative: Alternative) -> Answer:
    """Return the present draws with other weights, whether or not enough of them count."""
    log_ratios = np.asarray(alternative.space.log_prior(now.draws)) - now.log_prior
    if alternative.likelihood is not None and now.knowledge is not None:
        known = _with(now.knowledge, alternative)
        log_ratios = log_ratios + known.expected(now.draws, plug_in=known.plug_in(now.draws)) - now.log_likelihood
    log_weights = now.log_weights + log_ratios
    if not np.isfinite(log_weights).any():
        return Answer(alternative, now, None, None, math.inf, 0.0)
    smoothed = pareto_smoothed(log_weights)
    return Answer(
        alternative,
        now,
        "reweighting",
        Weighted(now.draws, smoothed.weights),
        k_hat=smoothed.k_hat,
        effective=smoothed.ess,
        log_evidence_change=float(logsumexp(log_weights)) if alternative.by_prior_alone else None,
    )


def _with(knowledge: Knowledge, alternative: Alternative) -> Knowledge:
    return knowledge if alternative.likelihood is None else replace(knowledge, likelihood=alternative.likelihood)


def _sampled(
    now: Baseline, knowledge: Knowledge, alternative: Alternative, k_hat: float, random: np.random.Generator
) -> Answer:
    """Sample an alternative's posterior by importance, beginning with its prior; by tempering if that fails."""
    known, space = _with(knowledge, alternative), alternative.free_space

    def plug_in(x: Float[np.ndarray, "point free"]) -> Values:
        return known.plug_in(alternative.whole(x))

    densities = prior_and_posterior(space, plug_in)
    pool = prior_pool(space, densities, POINTS)
    found = importance_or_smc(pool, densities, space, plug_in, random, enough=ENOUGH)
    whole = alternative.whole(found.x)
    total = found.log_weights + _gained(known, whole, found.log_weights, found.log_likelihood)
    change = found.log_evidence + float(logsumexp(total)) - now.log_evidence
    final = np.asarray(log_softmax(total))
    return Answer(
        alternative,
        now,
        found.by,
        Weighted(whole, np.exp(final)),
        k_hat=k_hat,
        effective=effective_size(final),
        log_evidence_change=change if alternative.by_prior_alone else None,
    )


def _gained(known: Knowledge, x: Points, log_weights: Values, plug_in: Values) -> Values:
    """Return log E[L] - log L at the points that count, 0 elsewhere."""
    out = np.zeros(len(x))
    order = np.argsort(-log_weights, kind="stable")
    some = order[: 1 + int(np.searchsorted(np.cumsum(np.exp(log_weights[order])), COUNTS))]
    out[some] = known.expected(x[some], plug_in=plug_in[some]) - plug_in[some]
    return out
