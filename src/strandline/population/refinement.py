"""Where to make further runs for specimens for which the surrogate is too coarse."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from strandline.population.specimen import SpecimenPosterior
from strandline.population.start import Start

__all__ = ["runs_for"]

OF_EACH, MOST = 8, 400
"""Largest number of draws of each posterior, and of all together, that are considered."""
LEAST_FEASIBLE = 0.5
"""Least probability that a run succeeds, relative to the safest one."""


def runs_for(begin: Start, specimens: Sequence[SpecimenPosterior], number: int) -> Float[np.ndarray, "run dim"]:
    """Return the inputs of runs at posterior draws, each the one that most reduces the variance of the field there.

    Args:
        begin: Surrogate of the interface.
        specimens: Posteriors that need a better surrogate.
        number: Largest number of runs.
    """
    of_each = max(min(OF_EACH, MOST // max(len(specimens), 1)), 1)
    step = max(len(specimens) * of_each // MOST, 1)
    places = [_places(begin, one, of_each) for one in specimens[::step]]
    x = np.concatenate(places) if places else np.empty((0, begin.space.dim))
    x = x[np.exp(begin.knowledge.log_feasibility(x)) >= LEAST_FEASIBLE] if len(x) else x
    if not len(x):
        return x
    surrogate = begin.knowledge.surrogate
    z = surrogate.warping.standardise(x)
    covariances = np.array([process.covariance(z, z) for process in surrogate.processes])
    nuggets = surrogate.scatter_variances
    chosen: list[int] = []
    while len(chosen) < min(number, len(x)):
        variances = np.einsum("mpp->mp", covariances) + nuggets[:, None] + 1e-15
        gains = (covariances**2).sum(axis=1) / variances
        total = gains.sum(axis=0)
        total[chosen] = -1.0
        best = int(np.argmax(total))
        chosen.append(best)
        row = covariances[:, best]
        covariances = covariances - row[:, :, None] * row[:, None, :] / variances[:, best, None, None]
    return np.asarray(x[chosen])


def _places(begin: Start, one: SpecimenPosterior, number: int) -> Float[np.ndarray, "some dim"]:
    draws = one.draws[:: max(len(one.draws) // number, 1)][:number]
    return begin.with_given(one.given).whole(draws)
