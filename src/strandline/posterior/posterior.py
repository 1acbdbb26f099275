"""The posterior as weighted particles, and its summaries, all of them weighted."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy.special import logsumexp

from strandline.errors import InvalidInput
from strandline.parameters import ParameterSpace
from strandline.posterior.shown import moments_line, moments_table
from strandline.posterior.weighted import Weighted

__all__ = ["Posterior", "systematic_indices"]


@dataclass(frozen=True, eq=False)
class Posterior:
    """Weighted draws of p(x, θ | Y) (paper (3a)) with the likelihood and prior of each.

    Args:
        space: the inputs, in the order of the columns of `draws`.
        draws: physical values (particle, dim).
        log_weights: normalised log weights (particle,); -inf is a particle without weight.
        log_likelihood: log-likelihood at each particle.
        log_prior: log prior density at each particle, in physical units.
        log_evidence: log of the integral of likelihood times prior.

    Tempering with a step control near 1 ends with unequal weights: an unweighted summary of `draws` is wrong.

    Raises:
        InvalidInput: lengths that differ, draws that are not finite, or weights that do not sum to one.
    """

    space: ParameterSpace
    draws: Float[np.ndarray, "particle dim"]
    log_weights: Float[np.ndarray, " particle"]
    log_likelihood: Float[np.ndarray, " particle"]
    log_prior: Float[np.ndarray, " particle"]
    log_evidence: float

    def __post_init__(self) -> None:
        _require_shapes(self)
        _require_normalised(self.log_weights)

    def __repr__(self) -> str:
        return f"<Posterior {self.line}; {self.number} particles, ESS {self.ess:.0f}>"

    def _repr_html_(self) -> str:
        low, high = self.quantiles([0.05, 0.95])
        columns = {"mean": self.mean, "sd": self.sd, "MAP": self.map_estimate, "5 %": low, "95 %": high}
        return moments_table(self.space, columns)

    @property
    def line(self) -> str:
        """Mean ± standard deviation of each input, in one line."""
        return moments_line(self.space, self.mean, self.sd)

    @cached_property
    def weights(self) -> Float[np.ndarray, " particle"]:
        """Normalised weights (particle,)."""
        return np.asarray(np.exp(self.log_weights))

    @property
    def number(self) -> int:
        """Number of particles."""
        return len(self.draws)

    @property
    def ess(self) -> float:
        """Effective sample size of the weights, 1 / Σ w²."""
        return float(1.0 / np.sum(self.weights**2))

    @property
    def mean(self) -> Float[np.ndarray, " dim"]:
        """Posterior mean (dim,)."""
        return Weighted(self.draws, self.weights).mean

    @property
    def covariance(self) -> Float[np.ndarray, "dim dim"]:
        """Posterior covariance (dim, dim): the second central moment of the weighted draws."""
        return Weighted(self.draws, self.weights).covariance

    @property
    def sd(self) -> Float[np.ndarray, " dim"]:
        """Posterior standard deviation (dim,)."""
        return np.sqrt(np.diag(self.covariance))

    def quantiles(self, p: Sequence[float] | Float[np.ndarray, " level"]) -> Float[np.ndarray, "level dim"]:
        """Return the smallest draw with weighted cumulative probability ≥ p, input by input (level, dim)."""
        levels = np.asarray(p, float)
        columns = [_weighted_quantile(column, self.weights, levels) for column in self.draws.T]
        return np.stack(columns, axis=1)

    @property
    def log_density(self) -> Float[np.ndarray, " particle"]:
        """Normalised log posterior density at the particles: log L + log prior - log Z (particle,)."""
        return np.asarray(self.log_likelihood + self.log_prior - self.log_evidence)

    @property
    def information(self) -> float:
        """What the data tell about the inputs, nats: the mean log-likelihood minus the log-evidence."""
        known = np.isfinite(self.log_likelihood)
        return float(self.weights[known] @ self.log_likelihood[known]) - self.log_evidence

    @property
    def map_index(self) -> int:
        """Index of the particle with the highest posterior density.

        With nuisance inputs among the columns this is the mode of the *joint* density; for the posterior under
        uncertainty see `histogram_mode` (paper, Remark 8).
        """
        density = self.log_likelihood + self.log_prior
        return int(np.argmax(np.where(np.isnan(density), -np.inf, density)))

    @property
    def map_estimate(self) -> Float[np.ndarray, " dim"]:
        """The particle with the highest posterior density (dim,), physical."""
        return np.asarray(self.draws[self.map_index])

    def columns(self, names: Sequence[str]) -> Float[np.ndarray, "particle column"]:
        """Return the draws of the inputs `names`, in that order: marginal draws, with the same weights."""
        unknown = [name for name in names if name not in self.space.names]
        if unknown:
            raise InvalidInput(
                "names of inputs of the posterior",
                value=unknown,
                expected=f"names out of {list(self.space.names)}",
                remedy="Correct the names.",
            )
        return np.asarray(self.draws[:, [self.space.names.index(name) for name in names]])

    def equally_weighted(self, seed: Any, number: int | None = None) -> Float[np.ndarray, "draw dim"]:
        """Return draws of equal weight by systematic resampling, in the order of the particles.

        Copies of one particle are adjacent, so that an autocorrelation-based effective sample size (such as ArviZ's)
        takes them into account.

        Args:
            seed: Integer, NumPy generator or JAX key.
            number: Number of draws; by default as many as there are particles.
        """
        size = self.number if number is None else number
        if size < 1:
            raise InvalidInput(
                "number of equally weighted draws",
                value=number,
                expected="at least 1",
                remedy="Ask for at least one draw.",
            )
        return np.asarray(self.draws[systematic_indices(self.weights, size, generator(seed))])


def systematic_indices(
    weights: Float[np.ndarray, " particle"], number: int, rng: np.random.Generator
) -> Int[np.ndarray, " draw"]:
    """Return `number` particle indices, ascending, by systematic resampling: one uniform number, equal strides."""
    positions = (rng.random() + np.arange(number)) / number
    cumulative = np.cumsum(weights)
    found = np.searchsorted(cumulative, positions * cumulative[-1], side="right")
    return np.asarray(np.minimum(found, np.flatnonzero(weights)[-1]))


def generator(seed: Any) -> np.random.Generator:
    """Return a NumPy generator from an integer, a generator or a JAX key."""
    if isinstance(seed, jax.Array):
        is_typed = jnp.issubdtype(seed.dtype, jax.dtypes.prng_key)
        words = jax.random.key_data(seed) if is_typed else seed
        return np.random.default_rng(np.asarray(words).ravel())
    return np.random.default_rng(seed)


def _weighted_quantile(
    values: Float[np.ndarray, " particle"], weights: Float[np.ndarray, " particle"], p: Float[np.ndarray, " level"]
) -> Float[np.ndarray, " level"]:
    return np.asarray(np.quantile(values, p, weights=weights, method="inverted_cdf"))


def _require_shapes(posterior: Posterior) -> None:
    number, dim = posterior.draws.shape
    lengths = [len(a) for a in (posterior.log_weights, posterior.log_likelihood, posterior.log_prior)]
    if number == 0 or dim != posterior.space.dim or set(lengths) != {number}:
        raise InvalidInput(
            "sizes of the posterior's arrays",
            value=f"draws {posterior.draws.shape}, weights, likelihoods and priors {lengths}",
            expected=f"(particle, {posterior.space.dim}) and three times (particle,)",
            remedy="Pass one value per particle and one column per input.",
        )
    if not np.isfinite(posterior.draws).all():
        bad = int(np.argmax(~np.isfinite(posterior.draws).all(axis=1)))
        raise InvalidInput(
            f"particle {bad} of the posterior",
            value=posterior.draws[bad].tolist(),
            expected="finite physical values",
            remedy="Check the sampler: a particle has left the design box.",
        )


def _require_normalised(log_weights: Float[np.ndarray, " particle"]) -> None:
    total = float(logsumexp(log_weights)) if not np.isnan(log_weights).any() else np.nan
    if not abs(total) < 1e-6:
        raise InvalidInput(
            "log of the sum of the posterior's weights",
            value=total,
            expected="0 (normalised log weights)",
            remedy="Subtract logsumexp(log_weights) first.",
        )
