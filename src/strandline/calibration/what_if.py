"""How a posterior changes with its assumptions: by weights of its draws, or by new draws through the surrogate.

The draws of the posterior get the weights p'(x) L'(x) / (p(x) L(x)), with the prior p and the likelihood L of the study
and those of the alternative. The largest weights are smoothed, and their tail decides whether they can be used (Vehtari
et al. 2024). If not, or if the alternative allows inputs where there are no draws, its posterior is sampled again,
through the surrogate of the interface. No forward run is made.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.special import log_softmax, logsumexp

from strandline.calibration.experiment import POINTS, FieldQuality, quality_at
from strandline.calibration.importance_sampler import effective_size, importance_or_smc, prior_and_posterior, prior_pool
from strandline.design import Knowledge
from strandline.foundations import require
from strandline.likelihood import FieldLikelihood
from strandline.parameters import ParameterSpace
from strandline.posterior import (
    Posterior,
    Weighted,
    pareto_smoothed,
    reliability_threshold,
    shifted,
    systematic_indices,
)

Kind = Literal["prior", "fix", "noise", "measure", "without", "model_error", "several"]
Points = Float[np.ndarray, "point dim"]
Values = Float[np.ndarray, " point"]
FEWEST = 100.0  # smallest effective number of draws after weighting: by the surrogate, or by an alternative
FIRST = 2048  # draws of the prior that sampling begins with
ENOUGH = 1000.0  # effective draws at which sampling ends
DRAWS = 2000  # equally weighted draws that are kept


@dataclass(frozen=True, eq=False)
class Alternative:
    """Another assumption: `name` in words, `kind` of what differs from the study, `about` what the posterior depends on
    if it moves, e.g. ``the prior of E``.

    `likelihood` is None for the one of the study, `fixed` has values of inputs that are taken as known, `detail` the
    assumption in numbers unless the name has them. With `by_prior_alone`, data, noise and measure stay.
    """

    name: str
    kind: Kind
    about: str
    space: ParameterSpace
    likelihood: FieldLikelihood | None = None
    fixed: Mapping[str, float] = field(default_factory=dict)
    detail: str = ""
    by_prior_alone: bool = True

    def __post_init__(self) -> None:
        left = any(self.space.names[i] not in self.fixed for i in self.space.calibrated)
        expected = "at least one calibrated input left"
        require(left, "inputs that are fixed", ", ".join(self.fixed), expected, "Fix fewer inputs.")
        _ = self.free_space

    def __repr__(self) -> str:
        return f"<Alternative {self.name}>"

    @cached_property
    def free(self) -> tuple[int, ...]:
        """Columns of the inputs that are not fixed."""
        return tuple(i for i, name in enumerate(self.space.names) if name not in self.fixed)

    @cached_property
    def free_space(self) -> ParameterSpace:
        return self.space.subspace(self.free)

    def whole(self, x: Float[np.ndarray, "point free"]) -> Points:
        """Return points with the fixed inputs among the others."""
        out = np.empty((len(x), self.space.dim))
        out[:, list(self.free)] = x
        for name, value in self.fixed.items():
            out[:, self.space.names.index(name)] = value
        return out


@dataclass(frozen=True, eq=False)
class Baseline:
    """A posterior as weighted draws, with the likelihood through the surrogate by which alternatives differ.

    Without a surrogate, `knowledge` and `quality`, how good it is at the draws, are None: only priors can be changed,
    and `why_not` says why. `shift` is the largest difference of a mean from the stored posterior, in sd.
    """

    space: ParameterSpace
    draws: Float[np.ndarray, "draw dim"]
    log_weights: Float[np.ndarray, " draw"]
    log_likelihood: Float[np.ndarray, " draw"]
    log_prior: Float[np.ndarray, " draw"]
    log_evidence: float
    knowledge: Knowledge | None = None
    quality: FieldQuality | None = None
    why_not: str = ""
    shift: float = 0.0

    def __repr__(self) -> str:
        known = "priors only" if self.knowledge is None else "through the surrogate of the interface"
        return f"<Present posterior of {', '.join(self.space.shown)}: {len(self.draws)} draws, {known}>"

    @cached_property
    def weighted(self) -> Weighted:
        return Weighted(self.draws, np.exp(self.log_weights))

    @cached_property
    def mean(self) -> Float[np.ndarray, " dim"]:
        """Mean of the inputs, physical."""
        return self.weighted.mean

    @cached_property
    def sd(self) -> Float[np.ndarray, " dim"]:
        return self.weighted.sd


def baseline(posterior: Posterior, knowledge: Knowledge | None, *, why_not: str = "") -> Baseline:
    """Return a posterior as alternatives are compared with it.

    With a surrogate of the interface, the draws get the weights of its likelihood: of a study that learns the
    interface, these are the stored ones; of one that learns the log-likelihood, both sides of each comparison then have
    the same errors. If too few draws remain effective, or the surrogate is too coarse, only priors can be changed;
    without one, `why_not` says why there is none.
    """
    known = np.isfinite(posterior.log_weights) & np.isfinite(posterior.log_likelihood)
    stored = Baseline(
        space=posterior.space,
        draws=posterior.draws[known],
        log_weights=np.asarray(log_softmax(posterior.log_weights[known])),
        log_likelihood=posterior.log_likelihood[known],
        log_prior=posterior.log_prior[known],
        log_evidence=posterior.log_evidence,
        why_not=why_not,
    )
    if knowledge is None:
        return stored
    values = knowledge.expected(stored.draws, plug_in=knowledge.plug_in(stored.draws))
    log_ratios = stored.log_weights + values - stored.log_likelihood
    effective = effective_size(log_ratios)
    if not effective >= FEWEST:
        return replace(stored, why_not=f"the surrogate of the interface leaves {effective:.0f} effective draws")
    log_weights = np.asarray(log_softmax(log_ratios))
    quality = quality_at(knowledge.likelihood, stored.draws, np.exp(log_weights))
    if not quality.good:
        why = (
            f"the surrogate of the interface is too coarse at {100 * quality.beyond:.0f} % of the posterior's draws: "
            f"it errs by {1e3 * quality.median:.2g} µm, and the local noise hides {1e3 * quality.hidden:.2g} µm"
        )
        return replace(stored, quality=quality, why_not=why)
    found = replace(
        stored,
        log_weights=log_weights,
        log_likelihood=values,
        log_evidence=stored.log_evidence + float(logsumexp(log_ratios)),
        knowledge=knowledge,
        quality=quality,
    )
    return replace(found, shift=float(np.abs((found.mean - stored.mean) / stored.sd).max()))


def interim_posterior(knowledge: Knowledge, space: ParameterSpace, *, seed: int) -> Baseline:
    """Return the posterior of the likelihood expected over the interfaces that the surrogate considers possible.

    It is sampled with a closed form of this likelihood; the draws are then weighted by the likelihood itself.
    """
    random = np.random.default_rng(seed)
    densities = prior_and_posterior(space, knowledge.nearly_expected)
    pool = prior_pool(space, densities, FIRST)
    found = importance_or_smc(pool, densities, space, knowledge.nearly_expected, random, enough=ENOUGH)
    draws = found.x[systematic_indices(np.exp(found.log_weights), DRAWS, random)]
    nearly = knowledge.nearly_expected(draws)
    values = knowledge.expected(draws, plug_in=knowledge.plug_in(draws))
    ratios = values - nearly
    log_weights = np.asarray(log_softmax(ratios))
    return Baseline(
        space=space,
        draws=draws,
        log_weights=log_weights,
        log_likelihood=values,
        log_prior=np.asarray(space.log_prior(draws)),
        log_evidence=found.log_evidence + float(logsumexp(ratios)) - math.log(DRAWS),
        knowledge=knowledge,
        quality=quality_at(knowledge.likelihood, draws, np.exp(log_weights)),
    )


LEAST_SHIFT = 0.2  # shift of a mean, in present standard deviations, from which an input moves
LEAST_RATIO = 1.25  # ratio of the standard deviations, or its inverse, from which an input moves
WIDEST = 1.3
"""Standard deviation, in those of the draws without weights, up to which reweighting is believed. From 1000 draws of a
Gaussian it gives widths of one 1.3, 1.5, 2 times as wide up to 10, 15, 29 % too small (1 in 20 of them more), mostly
with a k̂ that passes."""
COUNTS = 0.99  # share of the weight, on the largest ones, that gets the likelihood expected over possible fields
By = Literal["reweighting", "importance", "smc"]


@dataclass(frozen=True, eq=False)
class AlternativePosterior:
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
        moves = ", moves" if self.moves else ""
        return f"<AlternativePosterior {self.alternative.name}: {self.by or 'needs new runs'}{moves}>"

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


def reweight_or_resample(now: Baseline, alternative: Alternative, *, seed: int) -> AlternativePosterior:
    """Return the posterior under an alternative; the seed is for draws, if it is sampled again."""
    k_hat, effective, known = math.nan, 0.0, now.knowledge is not None or alternative.by_prior_alone
    if known and not alternative.fixed and _covered(now, alternative):
        found = reweighted(now, alternative)
        enough = found.k_hat < reliability_threshold(len(now.draws)) and found.effective >= FEWEST
        if enough and found.draws is not None and (found.draws.sd <= WIDEST * np.std(now.draws, axis=0)).all():
            return _judged(found)
        k_hat, effective = found.k_hat, found.effective
    if now.knowledge is None:
        return AlternativePosterior(alternative, now, None, None, k_hat, effective, why_not=now.why_not)
    return _judged(_sampled(now, now.knowledge, alternative, k_hat, np.random.default_rng(seed)))


def _judged(answer: AlternativePosterior) -> AlternativePosterior:
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


def reweighted(now: Baseline, alternative: Alternative) -> AlternativePosterior:
    """Return the present draws with other weights, whether or not enough of them count."""
    log_ratios = np.asarray(alternative.space.log_prior(now.draws)) - now.log_prior
    if alternative.likelihood is not None and now.knowledge is not None:
        known = _with(now.knowledge, alternative)
        log_ratios = log_ratios + known.expected(now.draws, plug_in=known.plug_in(now.draws)) - now.log_likelihood
    log_weights = now.log_weights + log_ratios
    if not np.isfinite(log_weights).any():
        return AlternativePosterior(alternative, now, None, None, math.inf, 0.0)
    smoothed = pareto_smoothed(log_weights)
    return AlternativePosterior(
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
) -> AlternativePosterior:
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
    return AlternativePosterior(
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
