"""A posterior whose sensitivity is examined, and alternatives to its assumptions."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.special import log_softmax, logsumexp

from strandline.calibration.importance_sampler import effective_size, importance_or_smc, prior_and_posterior, prior_pool
from strandline.calibration.source import FieldQuality, quality_at
from strandline.design import Knowledge
from strandline.foundations import InvalidInput
from strandline.likelihood import FieldLikelihood
from strandline.parameters import ParameterSpace
from strandline.posterior import Posterior, Weighted, systematic_indices

Kind = Literal["prior", "fix", "noise", "measure", "without", "model_error", "several"]
Points = Float[np.ndarray, "point dim"]
FEWEST = 100.0
"""Smallest effective number of the posterior's draws under the likelihood through the surrogate of the interface."""
FIRST = 2048
"""Draws of the prior that sampling begins with."""
ENOUGH = 1000.0
"""Effective draws at which sampling ends."""
DRAWS = 2000
"""Equally weighted draws that are kept."""


@dataclass(frozen=True, eq=False)
class Alternative:
    """Another assumption: `name` in words, `kind` of what differs from the study, `about` what the posterior depends on
    if it moves, e.g. ``the prior of E``.

    `likelihood` is None for the one of the study, `fixed` has values of inputs that are taken as known, `detail` the
    assumption in numbers unless the name has them. With `by_prior_alone`, data, noise and measure are those of the
    study.
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
        if all(self.space.names[i] in self.fixed for i in self.space.calibrated):
            raise InvalidInput(
                "inputs that are fixed",
                value=", ".join(self.fixed),
                expected="at least one calibrated input left",
                remedy="Fix fewer inputs.",
            )

    def __repr__(self) -> str:
        return f"<Alternative {self.name}>"

    @cached_property
    def free(self) -> tuple[int, ...]:
        """Columns of the inputs that are not fixed."""
        return tuple(i for i, name in enumerate(self.space.names) if name not in self.fixed)

    @cached_property
    def free_space(self) -> ParameterSpace:
        return ParameterSpace(tuple(self.space.parameters[i] for i in self.free))

    def whole(self, x: Float[np.ndarray, "point free"]) -> Points:
        """Return points with the fixed inputs among the others."""
        out = np.empty((len(x), self.space.dim))
        out[:, list(self.free)] = x
        for name, value in self.fixed.items():
            out[:, self.space.names.index(name)] = value
        return out


@dataclass(frozen=True, eq=False)
class Baseline:
    """A posterior as weighted draws, with the likelihood through the surrogate of the interface by which alternatives
    differ.

    Without a surrogate, `knowledge` and `quality`, how good it is at the draws, are None: only priors can be changed,
    and `why_not` says why. `shift` is the largest difference of a mean from the stored posterior, in standard
    deviations.
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
        return f"<Present posterior of {', '.join(self.space.names)}: {len(self.draws)} draws, {known}>"

    @cached_property
    def weighted(self) -> Weighted:
        return Weighted(self.draws, np.exp(self.log_weights))

    @cached_property
    def mean(self) -> Float[np.ndarray, " dim"]:
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
