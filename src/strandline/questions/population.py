"""The population that specimens come from: a hierarchical model of the mean and the spread of each input.

Input d of a specimen comes from N(m_d, s_d²), truncated to the box; the inputs are independent of each other within the
population. The likelihood of m and s is the product over the specimens of ∫ L_i(x) p(x | m, s) dx (Hogg, Myers and Bovy
2010, Eq. 8), with L_i the likelihood of specimen i. The prior of m_d is uniform over the box, and that of s_d uniform
from 0 to half its width (Gelman 2006 recommends a uniform density of the spread).

The likelihood of each specimen as a mixture of normal distributions, and its mean over a normal population.

The draws of a posterior, weighted by one over the prior, stand for the likelihood L_i of its inputs. Each draw becomes
a normal distribution, narrower than the posterior, and all move towards the mean so that the mixture keeps mean and
covariance (West 1993). Then the mean of L_i over a population N(m, S) is a sum of normal densities N(a_k; m, H_i + S),
which stays exact for a population far narrower than the posterior, where a mean over draws would see none of them.

Lengths are shares of the box: each input runs from 0 to 1. Population and parts are truncated to the box.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp, ndtr
from scipy.stats import chi2

from strandline.calibration import StudentMixture, importance_or_smc, prior_and_posterior, prior_pool
from strandline.foundations import require, with_sd
from strandline.parameters import Parameter, ParameterSpace, Uniform
from strandline.posterior import Weighted, pareto_smoothed, systematic_indices
from strandline.questions.specimen import SpecimenPosterior, matched

__all__ = ["FEWEST_SPECIMENS", "Population", "Shrunk", "population_of", "shrunk"]

WIDTH = 0.4  # standard deviation of a part, in posterior standard deviations
PARTS, MOST_PARTS, FEWEST_PARTS = 6000, 64, 4
"""Parts of all specimens together; most of one of them; fewest of one, per input."""
STEP = 1e-5  # step of differences of the log prior, as a share of the box
ROUNDING, TINY = 1e-12, 1e-300

Populations = Float[np.ndarray, "population dim"]


class MixtureParts(NamedTuple):
    """What is known of each specimen's inputs for one population: a mixture of normal distributions, not normalised."""

    log_weights: Float[np.ndarray, "specimen part"]
    means: Float[np.ndarray, "specimen part dim"]
    covariance: Float[np.ndarray, "specimen dim dim"]


@dataclass(frozen=True, eq=False)
class Mixtures:
    """The likelihoods of all specimens: the parts of each, its mean, and the covariance `spread` of the whole."""

    centres: Float[np.ndarray, "specimen part dim"]
    covariance: Float[np.ndarray, "specimen dim dim"]
    log_weights: Float[np.ndarray, "specimen part"]
    means: Float[np.ndarray, "specimen dim"]
    spread: Float[np.ndarray, "specimen dim dim"]

    @property
    def dim(self) -> int:
        return int(self.centres.shape[2])

    def parts(self, mean: Float[np.ndarray, " dim"], sd: Float[np.ndarray, " dim"]) -> MixtureParts:
        """Return the mixtures times the density of a population that has these moments before truncation."""
        S = sd**2
        C = self.covariance + np.diag(S)
        inverse = np.linalg.inv(C)
        off = self.centres - mean
        solved = off @ inverse
        log_density = -0.5 * (np.einsum("ikd,ikd->ik", solved, off) + np.linalg.slogdet(C)[1][:, None])
        means = mean + solved * S
        covariance = np.diag(S) - S[:, None] * inverse * S
        inside = log_mass(means, np.sqrt(np.maximum(np.einsum("idd->id", covariance), TINY))[:, None])
        return MixtureParts(self.log_weights + log_density + inside, means, covariance)

    def log_likelihoods(self, mean: Populations, sd: Populations) -> Float[np.ndarray, "population specimen"]:
        """Return the log-likelihood of each specimen for some populations, up to a constant of each specimen."""
        of_parts = [logsumexp(self.parts(m, s).log_weights, axis=1) for m, s in zip(mean, sd, strict=True)]
        return np.asarray(np.array(of_parts) - log_mass(mean, sd)[:, None])


def log_mass(mean: Float[np.ndarray, "..."], sd: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Return the log probability of the box for independent normal inputs, the last axis of means and sds."""
    inside = ndtr((1.0 - mean) / sd) - ndtr(-mean / sd)
    return np.asarray(np.log(np.maximum(inside, TINY)).sum(axis=-1))


def mixtures_of(specimens: Sequence[SpecimenPosterior]) -> Mixtures:
    """Return the likelihoods of specimens with the same unknown inputs, from their posteriors."""
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


FEWEST_SPECIMENS = 3
LARGEST_SPREAD = 0.5  # largest spread of an input, as a share of its box
ENOUGH = 2000.0  # effective sample size at which sampling ends
FIRST, AROUND = 512, 1024  # draws of the prior of mean and spread, and around a first guess
DRAWS = 500  # equally weighted draws that are kept
STRETCH = 1.5  # factor of the width of the first guess

Rows = Float[np.ndarray, "draw dim"]
Values = Float[np.ndarray, " draw"]


@dataclass(frozen=True, eq=False)
class Population:
    """Posterior of the mean and the spread of each input that is unknown for all specimens, in their population.

    Draws of both are shares of the box, and those of a normal distribution before it is truncated to the box.
    """

    space: ParameterSpace
    mixtures: Mixtures
    centre: Rows
    width: Rows

    def __repr__(self) -> str:
        means, sds = self.mean.mean(axis=0), self.sd.mean(axis=0)
        rows = zip(self.space, means, sds, strict=True)
        shown = (f"{one.name} {with_sd(a, b)}" for one, a, b in rows if one.of_field is None)
        return f"<Population of {len(self.mixtures.means)} specimens: {', '.join(shown)}>"

    @property
    def _range(self) -> Float[np.ndarray, " dim"]:
        return np.asarray(self.space.high - self.space.low)

    @cached_property
    def mean(self) -> Rows:
        """Draws of the population's mean of each input, physical."""
        return np.asarray(self.space.low + self._range * _cut_moments(self.centre, self.width)[0])

    @cached_property
    def sd(self) -> Rows:
        """Draws of the population's standard deviation of each input, physical."""
        return np.asarray(self._range * _cut_moments(self.centre, self.width)[1])

    def density(self, d: int, x: Float[np.ndarray, " place"]) -> Float[np.ndarray, "draw place"]:
        """Return the population's density of the input in column `d` at values of it, for each draw, per its unit."""
        m, s, u = self.centre[:, d, None], self.width[:, d, None], (x - self.space.low[d]) / self._range[d]
        inside = ndtr((1 - m) / s) - ndtr(-m / s)
        return np.asarray(np.exp(-0.5 * ((u - m) / s) ** 2) / (math.sqrt(2 * math.pi) * s * inside * self._range[d]))


def population_of(specimens: Sequence[SpecimenPosterior], *, seed: int = 1) -> Population:
    """Return the posterior of the population from the posteriors of its specimens, with the same unknown inputs.

    It depends on the seed and on the specimens, but not on their order.

    Raises:
        InvalidInput: There are fewer than three specimens, or their unknown inputs differ.
    """
    _require_alike(specimens)
    mixtures = mixtures_of(sorted(specimens, key=lambda one: one.name))
    random = np.random.default_rng([seed, len(specimens)])
    found = _sampled(mixtures, random)
    rows = found.draws[systematic_indices(found.weights, DRAWS, random)]
    rows = random.permutation(rows)
    return Population(specimens[0].space, mixtures, rows[:, : mixtures.dim], rows[:, mixtures.dim :])


def _require_alike(specimens: Sequence[SpecimenPosterior]) -> None:
    number, names = len(specimens), {one.space.names for one in specimens}
    words = f"at least {FEWEST_SPECIMENS}", "Add specimens; each posterior is valid alone."
    require(number >= FEWEST_SPECIMENS, "specimens of a population", number, *words)
    value, expected = "; ".join(sorted(", ".join(some) for some in names)), "the same ones for all specimens"
    remedy = "Give an input for all specimens or for none."
    require(len(names) == 1, "unknown inputs of the specimens", value, expected, remedy)


def _sampled(mixtures: Mixtures, random: np.random.Generator) -> Weighted:
    dim = mixtures.dim
    of_means = [Parameter(f"mean {d}", Uniform(0.0, 1.0)) for d in range(dim)]
    of_spreads = [Parameter(f"spread {d}", Uniform(0.0, LARGEST_SPREAD)) for d in range(dim)]
    space = ParameterSpace((*of_means, *of_spreads))

    def log_likelihood(x: Rows) -> Values:
        return np.asarray(mixtures.log_likelihoods(x[:, :dim], x[:, dim:]).sum(axis=1))

    log_densities = prior_and_posterior(space, log_likelihood)
    guess = _first_guess(mixtures)
    x = guess.draw(AROUND, random)
    pool = prior_pool(space, log_densities, FIRST).extended(guess, x, *log_densities(x))
    found = importance_or_smc(pool, log_densities, space, log_likelihood, random, enough=ENOUGH)
    return Weighted(found.x, np.exp(found.log_weights))


def _first_guess(mixtures: Mixtures) -> StudentMixture:
    """Return a wide distribution around the moments of the specimens' means."""
    number = len(mixtures.means)
    own = np.einsum("idd->id", mixtures.spread)
    middle = np.average(mixtures.means, axis=0, weights=1 / own.mean(axis=1))
    total = mixtures.means.var(axis=0)
    spread = np.sqrt(np.maximum(total - own.mean(axis=0), 0.05 * total + 1e-8))
    spread = np.minimum(spread, 0.9 * LARGEST_SPREAD)
    of_mean = np.sqrt((spread**2 + own.mean(axis=0)) / number)
    of_spread = (spread**2 + own.mean(axis=0)) / (spread * math.sqrt(2 * number))
    sds = STRETCH * np.concatenate([of_mean, np.minimum(of_spread, 0.5 * LARGEST_SPREAD)])
    return StudentMixture(np.ones(1), np.concatenate([middle, spread])[None], np.diag(sds)[None])


def _cut_moments(m: Rows, s: Rows) -> tuple[Rows, Rows]:
    """Return means and standard deviations of normal distributions that are truncated to [0, 1]."""
    a, b = -m / s, (1 - m) / s
    pa, pb = (np.exp(-0.5 * z**2) / math.sqrt(2 * math.pi) for z in (a, b))
    inside = np.maximum(ndtr(b) - ndtr(a), TINY)
    first = (pa - pb) / inside
    second = 1 + (a * pa - b * pb) / inside - first**2
    return np.asarray(m + s * first), np.asarray(s * np.sqrt(np.maximum(second, TINY)))


CHANCE = 0.05  # probability that any specimen is called an outlier if there is none
LEVELS = (0.05, 0.5, 0.95)


@dataclass(frozen=True, eq=False)
class Shrunk:
    """All specimens, each with what the others say about it: posterior means given all specimens, their standard
    deviations, and quantiles of 5, 50 and 95 %.

    `p_values` are the probabilities that a specimen of the others' population lies as far out; `z` is the distance from
    that population in standard deviations.
    """

    names: tuple[str, ...]
    mean: Float[np.ndarray, "specimen dim"]
    sd: Float[np.ndarray, "specimen dim"]
    quantiles: Float[np.ndarray, "specimen three dim"]
    p_values: Float[np.ndarray, " specimen"]
    z: Float[np.ndarray, "specimen dim"]

    def __repr__(self) -> str:
        return f"<Shrunk: {len(self.names)} specimens, outliers: {', '.join(self.outliers) or 'none'}>"

    @property
    def limit(self) -> float:
        """p-value below which a specimen is called an outlier."""
        return CHANCE / len(self.names)

    @property
    def outliers(self) -> tuple[str, ...]:
        """Names of the outliers, the farthest first."""
        order = np.argsort(self.p_values, kind="stable")
        return tuple(self.names[i] for i in order if self.p_values[i] < self.limit)


def shrunk(population: Population, names: tuple[str, ...], *, seed: int = 1) -> Shrunk:
    """Return the posterior of each specimen given all specimens, and how well it fits into the others' population.

    The names are those of the specimens, sorted; the seed is that of the draws behind the quantiles.
    """
    mixtures, random = population.mixtures, np.random.default_rng([seed, len(names), 1])
    number, dim = mixtures.means.shape
    first, second = np.zeros((number, dim)), np.zeros((number, dim))
    draws = np.empty((len(population.centre), number, dim))
    log_likelihoods = np.empty((len(population.centre), number))
    for j, (m, s) in enumerate(zip(population.centre, population.width, strict=True)):
        parts = mixtures.parts(m, s)
        log_likelihoods[j] = logsumexp(parts.log_weights, axis=1)
        share = np.exp(parts.log_weights - log_likelihoods[j][:, None])
        own = np.maximum(np.einsum("idd->id", parts.covariance), 0.0)
        first += np.einsum("ik,ikd->id", share, parts.means)
        second += np.einsum("ik,ikd->id", share, parts.means**2) + own
        chosen = _chosen(share, random)
        draws[j] = parts.means[np.arange(number), chosen] + np.sqrt(own) * random.standard_normal((number, dim))
    mean = first / len(draws)
    sd = np.sqrt(np.maximum(second / len(draws) - mean**2, 0.0))
    low, size = population.space.low, population.space.high - population.space.low
    quantiles = np.quantile(np.clip(draws, 0.0, 1.0), LEVELS, axis=0).swapaxes(0, 1)
    p_values, z = _fit_into_others(population, log_likelihoods)
    return Shrunk(names, low + size * mean, size * sd, low + size * quantiles, p_values, z)


def _chosen(share: Float[np.ndarray, "specimen part"], random: np.random.Generator) -> np.ndarray:
    below = np.cumsum(share, axis=1)
    return np.asarray((random.random((len(share), 1)) * below[:, -1:] > below).sum(axis=1))


def _fit_into_others(
    population: Population, log_likelihoods: Float[np.ndarray, "draw specimen"]
) -> tuple[Float[np.ndarray, " specimen"], Float[np.ndarray, "specimen dim"]]:
    """Return p-values and distances, with the population that the other specimens show.

    Weights 1/L_i turn draws of the population into draws without specimen i (Vehtari, Gelman and Gabry 2017). The
    distance is that of the mean of L_i from a new specimen's, whose covariance is that of L_i plus the population's.
    """
    mixtures = population.mixtures
    number, dim = mixtures.means.shape
    p_values, z = np.empty(number), np.empty((number, dim))
    for i in range(number):
        weights = pareto_smoothed(-log_likelihoods[:, i]).weights
        off = mixtures.means[i] - population.centre
        C = mixtures.spread[i] + np.einsum("jd,de->jde", population.width**2, np.eye(dim))
        squares = np.einsum("jd,jd->j", off, np.linalg.solve(C, off[:, :, None])[:, :, 0])
        p_values[i] = weights @ chi2.sf(squares, dim)
        sds = np.sqrt(weights @ (np.einsum("jdd->jd", C) + (off - weights @ off) ** 2))
        z[i] = (weights @ off) / sds
    return p_values, z
