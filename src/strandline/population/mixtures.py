"""The likelihood of each specimen as a mixture of normal distributions, and its mean over a normal population.

The draws of a posterior, weighted by one over the prior, stand for the likelihood L_i of its inputs. Each draw becomes
a normal distribution, narrower than the posterior, and all move towards the mean so that the mixture keeps mean and
covariance (West 1993). Then the mean of L_i over a population N(m, S) is a sum of normal densities N(a_k; m, H_i + S),
which stays exact for a population far narrower than the posterior, where a mean over draws would see none of them.

Lengths are shares of the box: each input runs from 0 to 1. Population and parts are truncated to the box.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp, ndtr

from strandline.parameters import ParameterSpace
from strandline.population.moments import matched
from strandline.population.specimen import SpecimenPosterior

__all__ = ["Mixtures", "Parts", "log_mass", "mixtures_of"]

WIDTH = 0.4
"""Standard deviation of a part, in posterior standard deviations."""
PARTS, MOST_PARTS, FEWEST_PARTS = 6000, 64, 4
"""Parts of all specimens together; most of one of them; fewest of one, per input."""
STEP = 1e-5
"""Step of differences of the log prior, as a share of the box."""
ROUNDING, TINY = 1e-12, 1e-300

Population = Float[np.ndarray, "population dim"]


class Parts(NamedTuple):
    """What is known of each specimen's inputs for one population: a mixture of normal distributions.

    Args:
        log_weights: Log weights, not normalised, shape (specimen, part).
        means: Their means, shape (specimen, part, dim).
        covariance: Their covariance, shape (specimen, dim, dim).
    """

    log_weights: Float[np.ndarray, "specimen part"]
    means: Float[np.ndarray, "specimen part dim"]
    covariance: Float[np.ndarray, "specimen dim dim"]


@dataclass(frozen=True, eq=False)
class Mixtures:
    """The likelihoods of all specimens.

    Args:
        centres: Means of the parts, shape (specimen, part, dim).
        covariance: Covariance of each part, shape (specimen, dim, dim).
        log_weights: Their log weights, shape (specimen, part).
        means: Mean of each likelihood, shape (specimen, dim).
        spread: Covariance of each likelihood, shape (specimen, dim, dim).
    """

    centres: Float[np.ndarray, "specimen part dim"]
    covariance: Float[np.ndarray, "specimen dim dim"]
    log_weights: Float[np.ndarray, "specimen part"]
    means: Float[np.ndarray, "specimen dim"]
    spread: Float[np.ndarray, "specimen dim dim"]

    @property
    def dim(self) -> int:
        """Number of inputs."""
        return int(self.centres.shape[2])

    def parts(self, mean: Float[np.ndarray, " dim"], sd: Float[np.ndarray, " dim"]) -> Parts:
        """Return the mixtures after the population's density has multiplied them.

        Args:
            mean: Means of the population before truncation.
            sd: Its standard deviations.
        """
        S = sd**2
        C = self.covariance + np.diag(S)
        inverse = np.linalg.inv(C)
        off = self.centres - mean
        solved = off @ inverse
        log_density = -0.5 * (np.einsum("ikd,ikd->ik", solved, off) + np.linalg.slogdet(C)[1][:, None])
        means = mean + solved * S
        covariance = np.diag(S) - S[:, None] * inverse * S
        inside = log_mass(means, np.sqrt(np.maximum(np.einsum("idd->id", covariance), TINY))[:, None])
        return Parts(self.log_weights + log_density + inside, means, covariance)

    def log_likelihoods(self, mean: Population, sd: Population) -> Float[np.ndarray, "population specimen"]:
        """Return the log-likelihood of each specimen for some populations, up to a constant of each specimen.

        Args:
            mean: Means of the populations before truncation.
            sd: Their standard deviations.
        """
        of_parts = [logsumexp(self.parts(m, s).log_weights, axis=1) for m, s in zip(mean, sd, strict=True)]
        return np.asarray(np.array(of_parts) - log_mass(mean, sd)[:, None])


def log_mass(mean: Float[np.ndarray, "..."], sd: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Return the log probability of the box for independent normal inputs.

    Args:
        mean: Their means, the inputs last.
        sd: Their standard deviations; the two shapes are broadcast.
    """
    inside = ndtr((1.0 - mean) / sd) - ndtr(-mean / sd)
    return np.asarray(np.log(np.maximum(inside, TINY)).sum(axis=-1))


def mixtures_of(specimens: Sequence[SpecimenPosterior]) -> Mixtures:
    """Return the likelihoods of specimens with the same unknown inputs.

    Args:
        specimens: Their posteriors.
    """
    number = int(np.clip(PARTS // len(specimens), FEWEST_PARTS * specimens[0].space.dim, MOST_PARTS))
    return Mixtures(*(np.array(part) for part in zip(*(_likelihood(one, number) for one in specimens), strict=True)))


def _likelihood(one: SpecimenPosterior, number: int) -> tuple[np.ndarray, ...]:
    """Return centres, covariance and log weights of the parts of a likelihood, its mean and its covariance."""
    space, draws = one.space, one.space.to_unit(one.draws)
    mean, spread = draws.mean(axis=0), np.atleast_2d(np.cov(draws.T, bias=True)) + ROUNDING * np.eye(one.space.dim)
    H, sds = WIDTH**2 * spread, WIDTH * np.sqrt(np.diag(spread))
    at = mean + (_thinned(draws, number) - mean) * math.sqrt(1 - WIDTH**2)
    log_prior, slopes = _log_prior(space, at)
    tilts = slopes @ H  # N(x; a, H) exp(-g·(x - a)) is again normal, with the mean a - Hg
    log_weights = 0.5 * np.einsum("kd,kd->k", tilts, slopes) - log_prior
    log_weights = np.where(np.isfinite(log_weights), log_weights, -np.inf)
    log_weights -= logsumexp(log_weights)
    centres, share = at - tilts, np.exp(log_weights)
    middle = share @ centres
    off = centres - middle
    return centres, H, log_weights - log_mass(at, sds), middle, H + (share[:, None] * off).T @ off


def _log_prior(
    space: ParameterSpace, u: Float[np.ndarray, "part dim"]
) -> tuple[Float[np.ndarray, " part"], Float[np.ndarray, "part dim"]]:
    """Return the log prior at shares of the box, and its derivatives; these are 0 where there are none."""
    u = np.clip(u, STEP, 1 - STEP)
    steps = STEP * np.eye(space.dim)
    values = np.asarray(space.log_prior(space.to_physical(u)))
    ahead, behind = (np.asarray(space.log_prior(space.to_physical(u[:, None] + by))) for by in (steps, -steps))
    with np.errstate(invalid="ignore"):
        slopes = (ahead - behind) / (2 * STEP)
    return values, np.where(np.isfinite(slopes), slopes, 0.0)


def _thinned(draws: Float[np.ndarray, "draw dim"], number: int) -> Float[np.ndarray, "part dim"]:
    """Return means of neighbouring draws, spread out to the covariance of all of them."""
    if number >= len(draws):
        return draws
    groups = np.array_split(draws, number)
    means = np.array([one.mean(axis=0) for one in groups])
    middle, wanted, of = draws.mean(axis=0), np.cov(draws.T, bias=True), np.cov(means.T, bias=True)
    return np.asarray(middle + (means - means.mean(axis=0)) @ matched(np.atleast_2d(of), np.atleast_2d(wanted)))
