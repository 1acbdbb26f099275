"""Are ranks uniform? Simultaneous bands for the distribution of ranks (Säilynoja, Bürkner and Vehtari 2022).

If a posterior is right, the truth's rank among its draws, over inputs drawn from the prior and observations drawn with
the stated noise, is uniform (Talts et al. 2018). The empirical distribution of the ranks then stays within the band
everywhere, at all places together, with the stated probability.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import binom

_SIMULATIONS = 5000


@dataclass(frozen=True, eq=False)
class Band:
    """The empirical distribution of ranks at places in (0, 1), and where it must lie.

    `p_value` is the probability that uniform ranks come as close to the edge of such a band, or beyond.
    """

    places: Float[np.ndarray, " place"]
    found: Float[np.ndarray, " place"]
    low: Float[np.ndarray, " place"]
    high: Float[np.ndarray, " place"]
    p_value: float

    @property
    def inside(self) -> bool:
        """Whether the distribution stays within the band everywhere."""
        return bool(((self.found >= self.low) & (self.found <= self.high)).all())


@dataclass(frozen=True, eq=False)
class Coverage:
    """How often central intervals of probability `level` of each input, or regions of the draws that fit best, contain
    the truth, with a 95 % interval (Wilson 1927).
    """

    level: float
    found: Float[np.ndarray, " dim"]
    low: Float[np.ndarray, " dim"]
    high: Float[np.ndarray, " dim"]


def weighted_ranks(
    x: Float[np.ndarray, "particle dim"], weights: Float[np.ndarray, " particle"], truth: Float[np.ndarray, " dim"]
) -> Float[np.ndarray, " dim"]:
    """Return the posterior probability below the truth in each input; ties count half."""
    below, equal = x < truth, x == truth
    return np.asarray(weights @ (below + 0.5 * equal) / weights.sum())


def uniformity(ranks: Float[np.ndarray, " replicate"], *, level: float = 0.95) -> Band:
    """Return the distribution of ranks in (0, 1) with its simultaneous band."""
    number = len(ranks)
    places = np.arange(1, number) / number
    counts = np.searchsorted(np.sort(ranks), places, side="right")
    least = _least_p_values(number)
    gamma = float(np.quantile(least, 1 - level))
    low, high = binom.ppf(gamma / 2, number, places), binom.isf(gamma / 2, number, places)
    own = float(_least_p_value(counts, number))
    return Band(places, counts / number, low / number, high / number, float((least <= own).mean()))


def coverage_of(ranks: Float[np.ndarray, "replicate dim"], level: float) -> Coverage:
    """Return how often the truth's rank lies in the central part of that probability."""
    return _counted(np.abs(ranks - 0.5) <= 0.5 * level, level)


def region_coverage_of(ranks: Float[np.ndarray, " replicate"], level: float) -> Coverage:
    """Return how often the truth's log-likelihood is above that of a share 1 - `level` of the posterior."""
    return _counted(ranks[:, None] >= 1 - level, level)


def _counted(contained: Bool[np.ndarray, "replicate dim"], level: float) -> Coverage:
    """Return how often intervals or regions of probability `level` contain the truth."""
    number, z = len(contained), 1.959964
    found = contained.mean(axis=0)
    centre, spread = found + z**2 / (2 * number), z * np.sqrt(found * (1 - found) / number + z**2 / (4 * number**2))
    factor = 1 / (1 + z**2 / number)
    return Coverage(level, found, factor * (centre - spread), factor * (centre + spread))


@lru_cache(maxsize=16)
def _least_p_values(number: int) -> Float[np.ndarray, " simulation"]:
    """Return the least pointwise p-value of each of many samples of uniform ranks."""
    places = np.arange(1, number) / number
    rows = np.sort(np.random.default_rng(0).random((_SIMULATIONS, number)), axis=1)
    return _least_p_value(np.array([np.searchsorted(row, places, side="right") for row in rows]), number)


def _least_p_value(counts: Int[np.ndarray, "*sample place"], number: int) -> Float[np.ndarray, "*sample"]:
    return np.asarray(_tails(number)[counts, np.arange(number - 1)].min(axis=-1))


@lru_cache(maxsize=16)
def _tails(number: int) -> Float[np.ndarray, "count place"]:
    counts, places = np.arange(number + 1)[:, None], np.arange(1, number) / number
    return np.asarray(2 * np.minimum(binom.cdf(counts, number, places), binom.sf(counts - 1, number, places)))
