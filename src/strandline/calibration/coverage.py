"""Would the intervals of a study contain the truth as often as they say?

The experiment is repeated at many true inputs: the surrogate of the interface predicts what is there to be seen, the
study's errors disturb it, and the same surrogate, measure and noise give the posterior. No forward run is made. If the
posteriors are right, the ranks of the truths in them are uniform (Talts et al. 2018). So is the rank of the truth's
log-likelihood among those of the draws, which shows mistakes that are spread over many inputs (Modrák et al. 2023).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from strandline.calibration.experiment import Experiment, Matrix, Source, experiment_behind
from strandline.calibration.importance_sampler import By, Points, Pool, Sampled, Values, importance_or_smc, only_inside
from strandline.likelihood import FieldLikelihood
from strandline.posterior import Band, Coverage, Weighted, coverage_of, region_coverage_of, uniformity, weighted_ranks

LEVELS = (0.5, 0.9)  # probabilities of the intervals whose coverage is counted
BAND = 0.95  # probability that all ranks stay inside their bands if the posteriors are right
CERTAIN = 3.0  # standard errors from which a mean z-score shows a shift
ENOUGH = 100  # replicates from which intervals that are a fifth too narrow or too wide would probably have shown
WIDTH = 0.15  # how far the standard deviation of shifted z-scores must exceed 1 to show that the width is wrong too


@dataclass(frozen=True, eq=False)
class Replicate:
    """One repetition of the experiment; its number and the seed decide all its random numbers.

    `ranks` are posterior probabilities below the truth in each input, `fit_rank` that of inputs whose log-likelihood is
    below that of the truth. `limit` are sds at the Cramér–Rao limit of the errors with the prior as a Gaussian.
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
    found, of_truth = _posterior(likelihood, source, truth, random)
    draws, fit = Weighted(found.x, np.exp(found.log_weights)), found.log_likelihood[:, None]
    return Replicate(
        number=number,
        truth=truth,
        ranks=weighted_ranks(draws.draws, draws.weights, truth),
        fit_rank=float(weighted_ranks(fit, draws.weights, np.array([of_truth]))[0]),
        mean=draws.mean,
        sd=draws.sd,
        limit=_limit(experiment.information(truth, truths), source.covariance),
        effective=draws.ess,
        by=found.by,
    )


def _posterior(
    likelihood: FieldLikelihood, source: Source, truth: Float[np.ndarray, " dim"], random: np.random.Generator
) -> tuple[Sampled, float]:
    """Sample the posterior, and return log L of the truth, which is not among the draws that sampling begins with."""

    def both(x: Points) -> tuple[Values, Values]:
        """Return the log densities of the source and of the posterior of points inside the box."""
        coefficients = likelihood.surrogate.mean(x)
        first = source.log_density(x, coefficients)
        return first, first + likelihood.at(coefficients)

    def from_prior(x: Points) -> Values:
        """Return what leads from the prior of the study to the posterior."""
        return np.asarray(both(x)[1] - np.asarray(source.space.log_prior(x)))

    own = (source.points == truth).all(axis=1)
    of_truth, *others = likelihood.at(np.vstack([likelihood.surrogate.mean(truth[None]), source.coefficients]))
    pool = Pool(
        x=source.points,
        log_counts=np.where(own, -np.inf, source.log_weights + np.log(source.number)),
        log_first=source.log_densities,
        log_target=source.log_densities + np.array(others),
        number=source.number,
    )
    space = source.space
    found = importance_or_smc(pool, only_inside(space.inside, both), space, from_prior, random)
    if found.by == "smc":
        found = found._replace(log_likelihood=likelihood.at(likelihood.surrogate.mean(found.x)))
    return found, float(of_truth)


def _limit(information: Matrix, covariance: Matrix) -> Float[np.ndarray, " dim"]:
    """Return the standard deviations for this information and a Gaussian prior, in scaled inputs."""
    scale = np.sqrt(np.diag(covariance))
    before = np.linalg.inv(covariance / np.outer(scale, scale))
    after = np.linalg.inv(before + information * np.outer(scale, scale))
    return np.asarray(scale * np.sqrt(np.diag(after)))


@dataclass(frozen=True, eq=False)
class CoverageFound:
    """What the replicates show."""

    names: tuple[str, ...]
    replicates: tuple[Replicate, ...]

    def __repr__(self) -> str:
        return f"<CoverageFound in {len(self.replicates)} replicates: {self.verdict}>"

    @cached_property
    def ranks(self) -> Float[np.ndarray, "replicate dim"]:
        return np.array([one.ranks for one in self.replicates])

    @cached_property
    def fit_ranks(self) -> Float[np.ndarray, " replicate"]:
        return np.array([one.fit_rank for one in self.replicates])

    @cached_property
    def bands(self) -> tuple[Band, ...]:
        """Distribution of the ranks of each input; its band and `fit_band` hold together."""
        return tuple(uniformity(column, level=self._level) for column in self.ranks.T)

    @cached_property
    def fit_band(self) -> Band:
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
        return np.array([(one.truth - one.mean) / one.sd for one in self.replicates])

    @cached_property
    def sd(self) -> Float[np.ndarray, " dim"]:
        return np.asarray(np.mean([one.sd for one in self.replicates], axis=0))

    @cached_property
    def of_limit(self) -> Float[np.ndarray, " dim"]:
        """Mean of the posterior standard deviations over those at the Cramér–Rao limit."""
        return np.asarray(np.mean([one.sd / one.limit for one in self.replicates], axis=0))

    @property
    def calibrated(self) -> bool:
        return self.fit_band.inside and all(band.inside for band in self.bands)

    @property
    def verdict(self) -> str:
        return self.remarks[0]

    @cached_property
    def remarks(self) -> tuple[str, ...]:
        """The verdict, with a sentence for each input whose ranks leave the band, and for the log-likelihood."""
        return tuple(self._faults()) or (self._right(),)

    def _right(self) -> str:
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
        for one in reversed(self.regions):
            often = f"the truth is among the {100 * one.level:.0f} % of its draws that fit best in"
            often = f"{often} {100 * one.found[0]:.3g} % of the replicates."
            if one.high[0] < one.level:
                return f"The posterior is too narrow: {often}"
            if one.low[0] > one.level:
                return f"The posterior is too wide: {often}"
        return f"The posterior is not calibrated: ranks of the log-likelihood leave the {100 * BAND:.0f} % band."

    def _fault(self, i: int, name: str) -> str:
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
