"""Where the true inputs of repeated experiments come from: the prior of a study, or its posterior.

Ranks of the truth are uniform if it comes from the distribution that the analysis takes as its prior (Talts et al.
2018). So with truths from the posterior, the analysis begins with this posterior, and a repeated observation adds to
the real one (Säilynoja et al. 2025).
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import log_softmax, logsumexp

from strandline.calibration.importance_sampler import effective_size
from strandline.design import sobol
from strandline.design.active import Knowledge
from strandline.errors import InvalidInput
from strandline.parameters import ParameterSpace
from strandline.posterior import Posterior, systematic_indices
from strandline.posterior.weighted import Weighted

__all__ = ["POINTS", "Source", "posterior_source", "prior_source"]

POINTS = 4096
"""Draws of the distribution whose predicted interfaces are kept for all replicates."""
SCRAMBLE = 0
"""Seed that scrambles their Sobol sequence; the plain one begins at a corner."""
FEWEST = 100.0
"""Smallest effective number of draws of a posterior that the surrogate of the interface agrees with."""


@dataclass(frozen=True, eq=False)
class Source:
    """A distribution of the inputs: that of the truths, and what each analysis takes as its prior.

    A region where runs fail is part of it only as far as they succeed there.

    Args:
        knowledge: Surrogate of the interface, feasibility, and likelihood of the real observation.
        space: All inputs.
        points: Draws with weights, shape (point, dim).
        log_weights: Their normalised log weights, shape (point,).
        coefficients: Predicted coefficients of the modes at the draws, shape (point, mode), mm.
        number: Number of equally weighted draws that they stand for.
        log_norm: Logarithm of the integral of the density before it is normalised.
        from_posterior: Whether the distribution is the posterior of the real observation.
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
        """Normalised log density at the draws."""
        return self.log_density(self.points, self.coefficients)

    @cached_property
    def covariance(self) -> Float[np.ndarray, "dim dim"]:
        """Covariance of the inputs."""
        return Weighted(self.points, np.exp(self.log_weights)).covariance

    def log_density(
        self, x: Float[np.ndarray, "some dim"], coefficients: Float[np.ndarray, "some mode"]
    ) -> Float[np.ndarray, " some"]:
        """Return the normalised log density at points inside the prior, given the coefficients predicted there."""
        known = self.knowledge.log_feasibility(x) + np.asarray(self.space.log_prior(x)) - self.log_norm
        return np.asarray(known + self.knowledge.likelihood.at(coefficients) if self.from_posterior else known)

    def inside(self, x: Float[np.ndarray, "some dim"]) -> Bool[np.ndarray, " some"]:
        """Return which points lie inside the prior."""
        within = ((x >= self.space.low) & (x <= self.space.high)).all(axis=1)
        out = np.zeros(len(x), bool)
        out[within] = np.isfinite(np.asarray(self.space.log_prior(x[within])))
        return out

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


def posterior_source(knowledge: Knowledge, posterior: Posterior, *, number: int = POINTS) -> Source:
    """Return the posterior, with weights by the log-likelihood of the predicted interface.

    Args:
        knowledge: Surrogate of the interface and its likelihood.
        posterior: The stored posterior.
        number: Number of equally weighted draws that represent it.

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
    drawn = systematic_indices(weights, number, np.random.default_rng(0))
    chosen, counts = np.unique(drawn, return_counts=True)
    points = draws[chosen]
    return Source(
        knowledge=knowledge,
        space=posterior.space,
        points=points,
        log_weights=np.log(counts / number),
        coefficients=knowledge.surrogate.mean(points),
        number=number,
        log_norm=posterior.log_evidence + float(logsumexp(log_weights)),
        from_posterior=True,
    )
