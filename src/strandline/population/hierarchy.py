"""The population that specimens come from: a hierarchical model of the mean and the spread of each input.

Input d of a specimen comes from N(m_d, s_d²), truncated to the box; the inputs are independent of each other within the
population. The likelihood of m and s is the product over the specimens of ∫ L_i(x) p(x | m, s) dx (Hogg, Myers and Bovy
2010, Eq. 8), with L_i the likelihood of specimen i. The prior of m_d is uniform over the box, and that of s_d uniform
from 0 to half its width (Gelman 2006 recommends a uniform density of the spread).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.special import ndtr

from strandline.calibration.importance_sampler import Pool, StudentMixture, followed
from strandline.calibration.log_densities import Densities, only_inside
from strandline.design import sobol
from strandline.design.refinement import SAMPLING
from strandline.errors import InvalidInput
from strandline.likelihood import OnHost
from strandline.parameters import ParameterSpace
from strandline.population.mixtures import Mixtures, mixtures_of
from strandline.population.specimen import SpecimenPosterior
from strandline.posterior import systematic_indices
from strandline.posterior.weighted import Weighted
from strandline.smc import sample
from strandline.text import with_sd

__all__ = ["FEWEST_SPECIMENS", "LARGEST_SPREAD", "Population", "population_of"]

FEWEST_SPECIMENS = 3
LARGEST_SPREAD = 0.5
"""Largest spread of an input, as a share of its box."""
ENOUGH = 2000.0
"""Effective sample size at which sampling ends."""
FIRST, AROUND = 512, 1024
"""Draws of the prior of mean and spread, and around a first guess."""
DRAWS = 500
"""Equally weighted draws that are kept."""
PARTICLES = 1000
STRETCH = 1.5
"""Factor of the width of the first guess."""
TINY = 1e-300

Rows = Float[np.ndarray, "draw dim"]
Values = Float[np.ndarray, " draw"]


@dataclass(frozen=True, eq=False)
class Population:
    """Posterior of the mean and the spread of each input in the population.

    Args:
        space: The inputs that are unknown for all specimens.
        mixtures: The likelihood of each specimen.
        centre: Draws of m, the means before truncation to the box, as shares of the box.
        width: Draws of s, the standard deviations before truncation, as shares of the box.
    """

    space: ParameterSpace
    mixtures: Mixtures
    centre: Rows
    width: Rows

    def __repr__(self) -> str:
        means, sds = self.mean.mean(axis=0), self.sd.mean(axis=0)
        shown = (f"{name} {with_sd(a, b)}" for name, a, b in zip(self.space.names, means, sds, strict=True))
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
        """Return the population's density of an input for each draw, per its unit.

        Args:
            d: Column of the input.
            x: Values of the input.
        """
        m, s, u = self.centre[:, d, None], self.width[:, d, None], (x - self.space.low[d]) / self._range[d]
        inside = ndtr((1 - m) / s) - ndtr(-m / s)
        return np.asarray(np.exp(-0.5 * ((u - m) / s) ** 2) / (math.sqrt(2 * math.pi) * s * inside * self._range[d]))


def population_of(specimens: Sequence[SpecimenPosterior], *, seed: int = 1) -> Population:
    """Return the posterior of the population from the posteriors of its specimens.

    It depends on the seed and on the specimens, but not on their order.

    Args:
        specimens: Posteriors with the same unknown inputs.
        seed: Seed of all random numbers, 0 or above.

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
    if len(specimens) < FEWEST_SPECIMENS:
        raise InvalidInput(
            "specimens of a population",
            value=len(specimens),
            expected=f"at least {FEWEST_SPECIMENS}",
            remedy="Add specimens; the posterior of each is valid without a population.",
        )
    names = {one.space.names for one in specimens}
    if len(names) > 1:
        raise InvalidInput(
            "unknown inputs of the specimens",
            value="; ".join(sorted(", ".join(some) for some in names)),
            expected="the same ones for all specimens",
            remedy="Give an input for all specimens or for none.",
        )


def _sampled(mixtures: Mixtures, random: np.random.Generator) -> Weighted:
    """Return weighted draws of (m, s)."""
    dim = mixtures.dim
    scales = np.repeat([1.0, LARGEST_SPREAD], dim)

    def both(x: Rows) -> tuple[Values, Values]:
        """Return the log densities of the prior and of the posterior of means and spreads that the prior allows."""
        first = np.full(len(x), -dim * math.log(LARGEST_SPREAD))
        return first, mixtures.log_likelihoods(x[:, :dim], x[:, dim:]).sum(axis=1)

    log_densities = only_inside(lambda x: np.all((x > 0) & (x < scales), axis=1), both)
    spread = scales * np.clip(sobol(FIRST, 2 * dim, scramble=0), 1e-9, 1 - 1e-9)
    pool = Pool(spread, np.zeros(FIRST), *log_densities(spread), FIRST)
    guess = _first_guess(mixtures)
    x = guess.draw(AROUND, random)
    found = followed(pool.extended(guess, x, *log_densities(x)), log_densities, random, enough=ENOUGH)
    return found.weighted if found is not None else _by_smc(log_densities, scales, random)


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


def _by_smc(log_densities: Densities, scales: Float[np.ndarray, " twice"], random: np.random.Generator) -> Weighted:
    """Sample (m, s) by tempering, from its prior."""

    def log_prior(x: jax.Array) -> jax.Array:
        inside = ((x > 0) & (x < scales)).all(axis=-1)
        return jnp.where(inside, -float(np.log(scales).sum()), -jnp.inf)

    initial = scales * random.random((PARTICLES, len(scales)))
    key = jax.random.key(int(random.integers(2**32)))
    found = sample(key, OnHost(lambda x: log_densities(x)[1]), log_prior, initial, settings=SAMPLING)
    return Weighted(found.positions, np.exp(found.log_weights))


def _cut_moments(m: Rows, s: Rows) -> tuple[Rows, Rows]:
    """Return means and standard deviations of normal distributions that are truncated to [0, 1]."""
    a, b = -m / s, (1 - m) / s
    pa, pb = (np.exp(-0.5 * z**2) / math.sqrt(2 * math.pi) for z in (a, b))
    inside = np.maximum(ndtr(b) - ndtr(a), TINY)
    first = (pa - pb) / inside
    second = 1 + (a * pa - b * pb) / inside - first**2
    return np.asarray(m + s * first), np.asarray(s * np.sqrt(np.maximum(second, TINY)))
