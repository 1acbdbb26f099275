"""Each specimen given all others: its shrunk posterior, and whether it is an outlier."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp
from scipy.stats import chi2

from strandline.population.hierarchy import Population
from strandline.posterior.pareto_smoothing import pareto_smoothed

__all__ = ["CHANCE", "Shrunk", "shrunk"]

CHANCE = 0.05
"""Probability that any specimen is called an outlier if there is none."""
LEVELS = (0.05, 0.5, 0.95)


@dataclass(frozen=True, eq=False)
class Shrunk:
    """All specimens, each with what the others say about it.

    Args:
        names: Names of the specimens.
        mean: Posterior means given all specimens, shape (specimen, dim).
        sd: Their standard deviations, shape (specimen, dim).
        quantiles: Quantiles of 5, 50 and 95 %, shape (specimen, 3, dim).
        p_values: Probability that a specimen of the others' population lies as far out, shape (specimen,).
        z: Distance of each specimen from the others' population in standard deviations, shape (specimen, dim).
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

    Args:
        population: Posterior of the population.
        names: Names of its specimens, sorted.
        seed: Seed of the draws behind the quantiles.
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
    """Return one part of each specimen, drawn with these probabilities."""
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
