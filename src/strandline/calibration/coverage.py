"""Would the intervals of a study contain the truth as often as they say?

The experiment is repeated at many true inputs: the surrogate of the interface predicts what is there to be seen, the
study's errors disturb it, and the same surrogate, measure and noise give the posterior. No forward run is made. If the
posteriors are right, the ranks of the truths in them are uniform (Talts et al. 2018). So is the rank of the truth's
log-likelihood among those of the draws, which shows mistakes that are spread over many inputs (Modrák et al. 2023).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from strandline.calibration.experiment import Experiment, experiment_behind
from strandline.calibration.importance_sampler import Pool, followed
from strandline.calibration.log_densities import only_inside
from strandline.calibration.source import Source
from strandline.design.refinement import SAMPLING
from strandline.likelihood import FieldLikelihood, OnHost
from strandline.posterior.uniformity import Band, Coverage, coverage_of, region_coverage_of, uniformity, weighted_ranks
from strandline.posterior.weighted import Weighted
from strandline.smc import sample

__all__ = ["LEVELS", "CoverageFound", "Replicate", "repeatable", "replicated"]

LEVELS = (0.5, 0.9)
"""Probabilities of the intervals whose coverage is counted."""
BAND = 0.95
"""Probability that all ranks stay inside their bands if the posteriors are right."""
PARTICLES = 2000
"""Particles of the tempered sampler, which takes over where importance sampling does not get there."""
CERTAIN = 3.0
"""Standard errors from which a mean z-score shows a shift."""
ENOUGH = 100
"""Replicates from which intervals that are a fifth too narrow or too wide would probably have shown."""
WIDTH = 0.15
"""How far the standard deviation of shifted z-scores must exceed 1 to show that the width is wrong too."""

By = Literal["importance", "smc"]


@dataclass(frozen=True, eq=False)
class Replicate:
    """One repetition of the experiment.

    Args:
        number: Its number; with the seed, it decides all its random numbers.
        truth: The true inputs, shape (dim,).
        ranks: Posterior probability below the truth in each input, shape (dim,).
        fit_rank: Posterior probability of inputs whose log-likelihood is below that of the truth.
        mean: Posterior means, shape (dim,).
        sd: Posterior standard deviations, shape (dim,).
        limit: Standard deviations at the Cramér–Rao limit of the errors with the prior as a Gaussian, shape (dim,).
        effective: Effective sample size of the posterior's draws.
        by: How the posterior was sampled.
    """

    number: int
    truth: Float[np.ndarray, " dim"]
    ranks: Float[np.ndarray, " dim"]
    fit_rank: float
    mean: Float[np.ndarray, " dim"]
    sd: Float[np.ndarray, " dim"]
    limit: Float[np.ndarray, " dim"]
    effective: float
    by: By


def repeatable(source: Source) -> Experiment:
    """Return the experiment behind the real observations, which are placed on the nearest predicted interface.

    Raises:
        InvalidInput: No independent errors of the points have the stated σ_N².
    """
    likelihood = source.knowledge.likelihood
    best = int(np.argmax(likelihood.at(source.coefficients)))
    return experiment_behind(likelihood, source.coefficients[best])


def replicated(experiment: Experiment, source: Source, *, seed: int, number: int) -> Replicate:
    """Return a repetition of the experiment; the same seed and number give the same one to the bit."""
    random = np.random.default_rng([seed, number])
    truth = source.draw(random)
    truths = experiment.truths(truth)
    likelihood = experiment.likelihood(experiment.observed(truths, random))
    found = _posterior(likelihood, source, truth, random)
    draws, fit = found.draws, found.log_likelihood[:, None]
    return Replicate(
        number=number,
        truth=truth,
        ranks=weighted_ranks(draws.draws, draws.weights, truth),
        fit_rank=float(weighted_ranks(fit, draws.weights, np.array([found.of_truth]))[0]),
        mean=draws.mean,
        sd=draws.sd,
        limit=_limit(experiment.information(truth, truths), source.covariance),
        effective=float(1 / np.sum(draws.weights**2)),
        by=found.by,
    )


class _Sampled(NamedTuple):
    """Draws of a posterior, with log L of each and of the truth."""

    draws: Weighted
    log_likelihood: Float[np.ndarray, " draw"]
    of_truth: float
    by: By


def _posterior(
    likelihood: FieldLikelihood, source: Source, truth: Float[np.ndarray, " dim"], random: np.random.Generator
) -> _Sampled:
    """Sample the posterior; the truth itself is not among the draws that sampling begins with."""

    def both(x: Float[np.ndarray, "point dim"]) -> tuple[Float[np.ndarray, " point"], Float[np.ndarray, " point"]]:
        """Return the log densities of the source and of the posterior of points inside the box."""
        coefficients = likelihood.surrogate.mean(x)
        first = source.log_density(x, coefficients)
        return first, first + likelihood.at(coefficients)

    own = (source.points == truth).all(axis=1)
    of_truth, *others = likelihood.at(np.vstack([likelihood.surrogate.mean(truth[None]), source.coefficients]))
    pool = Pool(
        x=source.points,
        log_counts=np.where(own, -np.inf, source.log_weights + np.log(source.number)),
        log_first=source.log_densities,
        log_target=source.log_densities + np.array(others),
        number=source.number,
    )
    found = followed(pool, only_inside(source.inside, both), random)
    if found is None:
        draws = _by_smc(likelihood, source, random)
        return _Sampled(draws, likelihood.at(likelihood.surrogate.mean(draws.draws)), of_truth, "smc")
    inside = np.isfinite(found.log_first)
    values = np.where(inside, found.log_target - np.where(inside, found.log_first, 0.0), -np.inf)
    return _Sampled(found.weighted, values, of_truth, "importance")


def _by_smc(likelihood: FieldLikelihood, source: Source, random: np.random.Generator) -> Weighted:
    """Sample the posterior by tempering, from the prior of the study."""
    space = source.space

    def log_likelihood(x: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, " point"]:
        coefficients = likelihood.surrogate.mean(x)
        before = source.log_density(x, coefficients) - np.asarray(space.log_prior(x))
        return np.asarray(before + likelihood.at(coefficients))

    initial = space.prior_quantiles(random.random((PARTICLES, space.dim)))
    key = jax.random.key(int(random.integers(2**32)))
    found = sample(key, OnHost(log_likelihood), space.log_prior, initial, settings=SAMPLING)
    return Weighted(found.positions, np.exp(found.log_weights))


def _limit(
    information: Float[np.ndarray, "dim dim"], covariance: Float[np.ndarray, "dim dim"]
) -> Float[np.ndarray, " dim"]:
    """Return the standard deviations for this information and a Gaussian prior, in scaled inputs."""
    scale = np.sqrt(np.diag(covariance))
    before = np.linalg.inv(covariance / np.outer(scale, scale))
    after = np.linalg.inv(before + information * np.outer(scale, scale))
    return np.asarray(scale * np.sqrt(np.diag(after)))


@dataclass(frozen=True, eq=False)
class CoverageFound:
    """What the replicates show.

    Args:
        names: Names of the inputs.
        replicates: The replicates.
    """

    names: tuple[str, ...]
    replicates: tuple[Replicate, ...]

    def __repr__(self) -> str:
        return f"<CoverageFound in {len(self.replicates)} replicates: {self.verdict}>"

    @cached_property
    def ranks(self) -> Float[np.ndarray, "replicate dim"]:
        """Ranks of the truths."""
        return np.array([one.ranks for one in self.replicates])

    @cached_property
    def fit_ranks(self) -> Float[np.ndarray, " replicate"]:
        """Ranks of the truths' log-likelihoods."""
        return np.array([one.fit_rank for one in self.replicates])

    @cached_property
    def bands(self) -> tuple[Band, ...]:
        """Distribution of the ranks of each input; its band and `fit_band` hold together."""
        return tuple(uniformity(column, level=self._level) for column in self.ranks.T)

    @cached_property
    def fit_band(self) -> Band:
        """Distribution of the ranks of the log-likelihood."""
        return uniformity(self.fit_ranks, level=self._level)

    @property
    def _level(self) -> float:
        return 1 - (1 - BAND) / (len(self.names) + 1)

    @cached_property
    def regions(self) -> tuple[Coverage, ...]:
        """How often the truth is among the draws that fit best, for regions of the probabilities `LEVELS`."""
        return tuple(region_coverage_of(self.fit_ranks, level) for level in LEVELS)

    @cached_property
    def intervals(self) -> tuple[Coverage, ...]:
        """How often intervals of the probabilities `LEVELS` contain the truth."""
        return tuple(coverage_of(self.ranks, level) for level in LEVELS)

    @cached_property
    def z(self) -> Float[np.ndarray, "replicate dim"]:
        """Truth minus posterior mean, in posterior standard deviations."""
        return np.array([(one.truth - one.mean) / one.sd for one in self.replicates])

    @cached_property
    def sd(self) -> Float[np.ndarray, " dim"]:
        """Mean of the posterior standard deviations."""
        return np.asarray(np.mean([one.sd for one in self.replicates], axis=0))

    @cached_property
    def of_limit(self) -> Float[np.ndarray, " dim"]:
        """Mean of the posterior standard deviations over those at the Cramér–Rao limit."""
        return np.asarray(np.mean([one.sd / one.limit for one in self.replicates], axis=0))

    @property
    def calibrated(self) -> bool:
        """Whether all ranks stay inside their bands."""
        return self.fit_band.inside and all(band.inside for band in self.bands)

    @property
    def verdict(self) -> str:
        """The verdict in a sentence."""
        return self.remarks[0]

    @cached_property
    def remarks(self) -> tuple[str, ...]:
        """The verdict, with a sentence for each input whose ranks leave the band, and for the log-likelihood."""
        return tuple(self._faults()) or (self._right(),)

    def _right(self) -> str:
        """Return what the replicates show if the ranks of all inputs stay inside their bands."""
        if len(self.replicates) < ENOUGH:
            return (
                f"Nothing speaks against the posterior, but {len(self.replicates)} replicates show only gross errors; "
                f"make at least {ENOUGH}."
            )
        return f"The posterior is calibrated: all ranks stay inside the {100 * BAND:.0f} % band."

    def _faults(self) -> Iterator[str]:
        for i, (name, band) in enumerate(zip(self.names, self.bands, strict=True)):
            if not band.inside:
                yield self._fault(i, name)
        if not self.fit_band.inside:
            yield self._fault_of_fit()

    def _fault_of_fit(self) -> str:
        """Return what the ranks of the log-likelihood show: a truth that fits worse than draws do, or better."""
        for one in reversed(self.regions):
            often = f"the truth is among the {100 * one.level:.0f} % of its draws that fit best in"
            often = f"{often} {100 * one.found[0]:.3g} % of the replicates."
            if one.high[0] < one.level:
                return f"The posterior is too narrow: {often}"
            if one.low[0] > one.level:
                return f"The posterior is too wide: {often}"
        return f"The posterior is not calibrated: ranks of the log-likelihood leave the {100 * BAND:.0f} % band."

    def _fault(self, i: int, name: str) -> str:
        """Return what is wrong with the intervals of an input: their width, their place, or something else."""
        z = self.z[:, i]
        shifted = abs(z.mean()) > CERTAIN * z.std() / np.sqrt(len(z))
        for one in reversed(self.intervals):
            often = f"{100 * one.level:.0f} % intervals of {name} contain the truth in {100 * one.found[i]:.3g} % of"
            if one.high[i] < one.level and (z.std() > 1 + WIDTH or not shifted):
                return f"The posterior is too narrow: {often} the replicates."
            if one.low[i] > one.level:
                return f"The posterior is too wide: {often} the replicates."
        if shifted:
            side = "low" if z.mean() > 0 else "high"
            return f"The posterior is shifted: means of {name} are {abs(z.mean()):.2g} standard deviations too {side}."
        return f"The posterior is not calibrated: ranks of {name} leave the {100 * BAND:.0f} % band."
