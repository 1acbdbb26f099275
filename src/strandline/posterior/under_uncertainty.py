"""The posterior of the calibrated inputs x when further inputs θ are uncertain (paper (3b)), in its two readings.

joint: ∫ p(x, θ | Y) dθ. The data inform θ as well, and x is weighted accordingly.
cut: E over θ ~ p(θ) of p(x | θ, Y), each conditional posterior normalised by its own evidence Z(θ). The data do not
inform θ.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int
from scipy.special import logsumexp
from scipy.stats import qmc

from strandline.foundations import require
from strandline.parameters import ParameterSpace
from strandline.posterior.posterior import Posterior, histogram_mode


@runtime_checkable
class Conditional(Protocol):
    """Weighted draws of p(x | θ, Y) for one θ, with its evidence Z(θ); the sampler's result is an example."""

    @property
    def positions(self) -> Float[np.ndarray, "particle x"]: ...
    @property
    def log_weights(self) -> Float[np.ndarray, " particle"]: ...
    @property
    def log_likelihood(self) -> Float[np.ndarray, " particle"]: ...
    @property
    def log_evidence(self) -> float: ...


@dataclass(frozen=True, eq=False)
class MarginalPosterior:
    """One reading under uncertainty: weighted draws of x and θ; leaving out the columns of θ integrates over it."""

    extended: Posterior

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibrated inputs, in the order of all arrays here."""
        return self.extended.space.calibrated_space.names

    @property
    def mean(self) -> Float[np.ndarray, " x"]:
        """Mean."""
        return np.asarray(self.extended.mean[self._columns])

    @property
    def covariance(self) -> Float[np.ndarray, "x x"]:
        """Covariance."""
        return np.asarray(self.extended.covariance[np.ix_(self._columns, self._columns)])

    @property
    def sd(self) -> Float[np.ndarray, " x"]:
        """Standard deviations."""
        return np.sqrt(np.diag(self.covariance))

    def quantiles(self, p: float | Sequence[float]) -> Float[np.ndarray, "*level x"]:
        """Return the weighted quantiles, input by input."""
        return np.asarray(self.extended.quantiles(p)[..., self._columns])

    @property
    def map_bins(self) -> int:
        """Bins per input of the histogram that yields `map_estimate`."""
        return mode_bins(len(self._columns))

    @property
    def map_estimate(self) -> Float[np.ndarray, " x"]:
        """The centre of the fullest bin of the weighted histogram over the design box (paper, Remark 8)."""
        space, columns = self.extended.space, self._columns
        bounds = [parameter.interval for parameter in space.calibrated_space]
        return histogram_mode(self.extended.draws[:, columns], self.extended.weights, bounds=bounds, bins=self.map_bins)

    @property
    def _columns(self) -> list[int]:
        return list(self.extended.space.calibrated)


@dataclass(frozen=True, eq=False)
class Cut(MarginalPosterior):
    """The cut reading, with the values of θ that represent p(θ), each with the same probability.

    The likelihood of its pooled draws is L(x, θ)/Z(θ), so that their evidence is 1. `log_evidence` is that of each
    value, log Z(θ) = log ∫ L(x, θ) p(x) dx, and `value_index` the row of each draw in `values`.
    """

    values: Float[np.ndarray, "value nuisance"]
    log_evidence: Float[np.ndarray, " value"]
    value_index: Int[np.ndarray, " particle"]

    @property
    def joint_log_evidence(self) -> float:
        """Log of the mean of Z(θ): the log-evidence of the joint reading, computed in another way."""
        return float(logsumexp(self.log_evidence) - np.log(len(self.log_evidence)))


@dataclass(frozen=True, eq=False)
class UnderUncertainty:
    """Both readings of the posterior under uncertainty."""

    joint: MarginalPosterior
    cut: Cut


def mode_bins(dim: int) -> int:
    """Return the bins per input of a histogram whose fullest bin is the MAP: the study's 30 in 2-D and 10 in 6-D."""
    return 30 if dim <= 2 else 20 if dim == 3 else 10


def nuisance_values(space: ParameterSpace, number: int) -> Float[np.ndarray, "value nuisance"]:
    """Return `number` values of the nuisance inputs that represent their prior with equal weights.

    One input: the quantiles (m + ½)/number. Several: a Sobol sequence, every coordinate in the middle of its stratum,
    mapped by the quantiles; a power of two is best.
    """
    found = f"{number} for {len(space.nuisance)} nuisance inputs"
    words = "at least one value and one nuisance input", "Declare an input nuisance, and ask for 32 values."
    require(number >= 1 and space.nuisance, "values of the nuisance inputs", found, *words)
    columns = list(space.nuisance)
    levels = np.full((number, space.dim), 0.5)
    levels[:, columns] = _levels(number, len(columns))
    return space.prior_quantiles(levels)[:, columns]


def pooled(
    space: ParameterSpace, values: Float[np.ndarray, "value nuisance"], conditionals: Sequence[Conditional]
) -> Cut:
    """Return the equal mixture of p(x | θ, Y) over the rows θ of `values`: total weight 1/values for each."""
    index = np.repeat(np.arange(len(values)), [len(c.positions) for c in conditionals])
    draws = np.empty((len(index), space.dim))
    draws[:, list(space.calibrated)] = np.concatenate([c.positions for c in conditionals])
    draws[:, list(space.nuisance)] = values[index]
    log_evidence = np.array([c.log_evidence for c in conditionals])
    return Cut(
        extended=Posterior(
            space=space,
            draws=draws,
            log_weights=np.concatenate([c.log_weights for c in conditionals]) - np.log(len(values)),
            log_likelihood=np.concatenate([c.log_likelihood for c in conditionals]) - log_evidence[index],
            log_prior=np.asarray(space.log_prior(draws)),
            log_evidence=0.0,
        ),
        values=values,
        log_evidence=log_evidence,
        value_index=index,
    )


def _levels(number: int, dim: int) -> Float[np.ndarray, "value dim"]:
    if dim == 1:
        return (np.arange(number)[:, None] + 0.5) / number
    bits = max(number - 1, 1).bit_length()
    return np.asarray(qmc.Sobol(dim, scramble=False).random_base2(bits)[:number] + 0.5 ** (bits + 1))
