"""The posterior that a surrogate of the interface gives, from whatever runs there are."""

import math

import jax
import numpy as np
from jaxtyping import Float
from scipy.special import log_softmax, logsumexp

from strandline.calibration.alternative import Present
from strandline.calibration.field_quality import quality_at
from strandline.calibration.importance_sampler import Pool, followed
from strandline.calibration.log_densities import prior_and_posterior
from strandline.design import sobol
from strandline.design.active import Knowledge
from strandline.design.refinement import SAMPLING
from strandline.likelihood import OnHost
from strandline.parameters import ParameterSpace
from strandline.posterior import systematic_indices
from strandline.smc import sample

__all__ = ["posterior_so_far"]

FIRST, SCRAMBLE = 2048, 0
"""Draws of the prior that sampling begins with."""
ENOUGH = 1000.0
"""Effective draws at which sampling ends."""
DRAWS = 2000
"""Equally weighted draws that are kept."""

Points = Float[np.ndarray, "point dim"]


def posterior_so_far(knowledge: Knowledge, space: ParameterSpace, *, seed: int) -> Present:
    """Return the posterior of the likelihood expected over the interfaces that the surrogate considers possible.

    It is sampled with a closed form of this likelihood; the draws are then weighted by the likelihood itself.

    Args:
        knowledge: What is known from the runs.
        space: All inputs with their priors.
        seed: Seed of all random numbers.
    """
    random = np.random.default_rng(seed)
    densities = prior_and_posterior(space, knowledge.nearly_expected)
    first = space.prior_quantiles(sobol(FIRST, space.dim, scramble=SCRAMBLE))
    found = followed(Pool(first, np.zeros(FIRST), *densities(first), FIRST), densities, random, enough=ENOUGH)
    if found is not None:
        weights, positions, log_integral = np.exp(found.log_weights), found.x, found.log_integral
    else:
        initial = space.prior_quantiles(random.random((DRAWS, space.dim)))
        key = jax.random.key(int(random.integers(2**32)))
        drawn = sample(key, OnHost(knowledge.nearly_expected), space.log_prior, initial, settings=SAMPLING)
        weights, positions = np.exp(np.asarray(log_softmax(drawn.log_weights))), np.asarray(drawn.positions)
        log_integral = float(drawn.log_evidence)
    draws = positions[systematic_indices(weights, DRAWS, random)]
    nearly = knowledge.nearly_expected(draws)
    values = knowledge.expected(draws, plug_in=knowledge.plug_in(draws))
    ratios = values - nearly
    log_weights = np.asarray(log_softmax(ratios))
    return Present(
        space=space,
        draws=draws,
        log_weights=log_weights,
        log_likelihood=values,
        log_prior=np.asarray(space.log_prior(draws)),
        log_evidence=log_integral + float(logsumexp(ratios)) - math.log(DRAWS),
        knowledge=knowledge,
        quality=quality_at(knowledge.likelihood, draws, np.exp(log_weights)),
    )
