"""Where the true inputs of repeated experiments come from: the prior of a study, or its posterior.

Ranks of the truth are uniform if it comes from the distribution that the analysis takes as its prior (Talts et al.
2018). So with truths from the posterior, the analysis begins with this posterior, and a repeated observation adds to
the real one (Säilynoja et al. 2025).
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.special import log_softmax, logsumexp

from strandline.calibration.importance_sampler import SCRAMBLE, effective_size
from strandline.design import Knowledge, sobol
from strandline.foundations import InvalidInput
from strandline.likelihood import FieldLikelihood, noise_length
from strandline.parameters import ParameterSpace
from strandline.posterior import Posterior, Weighted, systematic_indices
from strandline.surrogate import FieldSurrogate

POINTS = 4096
"""Draws of the distribution whose predicted interfaces are kept for all replicates."""
FEWEST = 100.0
"""Smallest effective number of draws of a posterior that the surrogate of the interface agrees with."""
TOLERATED = 0.5
"""Error of the predicted interface that is tolerated, as a share of the shift that the noise hides."""
TOLERATED_SHARE = 0.05
"""Share of the draws at which a larger error is tolerated."""
DRAWS = 512


@dataclass(frozen=True, eq=False)
class Source:
    """A distribution of the inputs: that of the truths, and what each analysis takes as its prior.

    A region where runs fail is part of it only as far as they succeed there. `points` are weighted draws that stand for
    `number` equally weighted ones, with the coefficients of the modes predicted there, mm. `log_norm` is the logarithm
    of the integral of the density before it is normalised.
    """

    knowledge: Knowledge
    space: ParameterSpace
    points: Float[np.ndarray, "point dim"]
    log_weights: Float[np.ndarray, " point"]
    coefficients: Float[np.ndarray, "point mode"]
    number: int
    log_norm: float
    from_posterior: bool

    @cached_property
    def log_densities(self) -> Float[np.ndarray, " point"]:
        return self.log_density(self.points, self.coefficients)

    @cached_property
    def covariance(self) -> Float[np.ndarray, "dim dim"]:
        return Weighted(self.points, np.exp(self.log_weights)).covariance

    def log_density(
        self, x: Float[np.ndarray, "some dim"], coefficients: Float[np.ndarray, "some mode"]
    ) -> Float[np.ndarray, " some"]:
        """Return the normalised log density at points inside the prior, given the coefficients predicted there."""
        known = self.knowledge.log_feasibility(x) + np.asarray(self.space.log_prior(x)) - self.log_norm
        return np.asarray(known + self.knowledge.likelihood.at(coefficients) if self.from_posterior else known)

    def draw(self, random: np.random.Generator) -> Float[np.ndarray, " dim"]:
        """Return one draw: of the prior a new one, of a posterior one of `points`."""
        if self.from_posterior:
            weights = np.exp(self.log_weights)
            return np.asarray(self.points[random.choice(len(weights), p=weights / weights.sum())])
        while True:
            x = self.space.prior_quantiles(random.random((1, self.space.dim)))
            if random.random() < np.exp(self.knowledge.log_feasibility(x)[0]):
                return np.asarray(x[0])


def prior_source(knowledge: Knowledge, space: ParameterSpace, *, number: int = POINTS) -> Source:
    """Return the prior, as far as runs succeed, represented by a number of draws."""
    points = space.prior_quantiles(sobol(number, space.dim, scramble=SCRAMBLE))
    feasible = knowledge.log_feasibility(points)
    return Source(
        knowledge=knowledge,
        space=space,
        points=points,
        log_weights=np.asarray(log_softmax(feasible)),
        coefficients=knowledge.surrogate.mean(points),
        number=len(points),
        log_norm=float(logsumexp(feasible)) - math.log(len(points)),
        from_posterior=False,
    )


def posterior_source(knowledge: Knowledge, posterior: Posterior) -> Source:
    """Return the posterior, with weights by the log-likelihood of the predicted interface, as equally weighted draws.

    Raises:
        InvalidInput: Hardly any draws have weight, since the posterior was computed from another likelihood.
    """
    known = np.isfinite(posterior.log_weights) & np.isfinite(posterior.log_likelihood)
    draws = posterior.draws[known]
    log_weights = posterior.log_weights[known] + knowledge.plug_in(draws) - posterior.log_likelihood[known]
    effective = effective_size(log_weights)
    if effective < FEWEST:
        raise InvalidInput(
            "the stored posterior and the surrogate of the interface disagree",
            value=f"{effective:.0f} effective draws of {posterior.number}",
            expected=f"at least {FEWEST:.0f}",
            remedy="Make more runs where the posterior lies, or draw the truths from the prior.",
        )
    weights = np.exp(log_softmax(log_weights))
    drawn = systematic_indices(weights, POINTS, np.random.default_rng(0))
    chosen, counts = np.unique(drawn, return_counts=True)
    points = draws[chosen]
    return Source(
        knowledge=knowledge,
        space=posterior.space,
        points=points,
        log_weights=np.log(counts / POINTS),
        coefficients=knowledge.surrogate.mean(points),
        number=POINTS,
        log_norm=posterior.log_evidence + float(logsumexp(log_weights)),
        from_posterior=True,
    )


@dataclass(frozen=True)
class FieldQuality:
    """Errors of the predicted interface, root mean square along it, at draws of a distribution; mm.

    `hidden` is the shift of the observed interface that the noise hides, the smallest of all conditions; `median` and
    `q95` are quantiles of the errors that the surrogate expects, `left_out` is the median error at runs predicted from
    the others, and `beyond` the share of the draws with an error above `TOLERATED` times `hidden`.
    """

    hidden: float
    median: float
    q95: float
    left_out: float
    beyond: float

    @property
    def good(self) -> bool:
        return self.beyond <= TOLERATED_SHARE


def field_quality(source: Source) -> FieldQuality:
    """Return how good the surrogate is at draws of a distribution."""
    return quality_at(source.knowledge.likelihood, source.points, np.exp(source.log_weights))


def quality_at(
    likelihood: FieldLikelihood, points: Float[np.ndarray, "point dim"], weights: Float[np.ndarray, " point"]
) -> FieldQuality:
    """Return how good the surrogate is at weighted points, for the noise of a likelihood.

    The errors that it expects count more if those at left-out runs are larger than expected.
    """
    surrogate = likelihood.surrogate
    hidden = min(noise_length(seen, likelihood.discrepancy) for seen in likelihood.known_observations)
    chosen = np.random.default_rng(0).choice(len(weights), DRAWS, p=weights / weights.sum())
    errors = max(1.0, _surprise(surrogate)) * surrogate.predicted_error(points[chosen])
    median, q95 = np.quantile(errors, [0.5, 0.95]).tolist()
    return FieldQuality(
        hidden=hidden,
        median=median,
        q95=q95,
        left_out=float(np.median(surrogate.left_out_error())),
        beyond=float((errors > TOLERATED * hidden).mean()),
    )


def _surprise(surrogate: FieldSurrogate) -> float:
    """Return the root mean square error at left-out runs over the expected one."""
    left_out = [process.left_out() for process in surrogate.processes]
    found = sum(float(np.sum(one.errors**2)) for one in left_out)
    expected = sum(float(np.sum(one.variances)) for one in left_out)
    return float(np.sqrt(found / expected)) if expected > 0 else 1.0
