"""Target densities with exactly known evidence and moments, for tests of samplers and quadratures."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy import special

__all__ = ["KnownPosterior", "banana", "gaussian", "linear_exponential", "truncated_gaussian", "uniform"]

Batched = Callable[[Any], Any]


@dataclass(frozen=True, eq=False)
class KnownPosterior:
    """A posterior on a box under a uniform prior, with its evidence and moments.

    Args:
        log_likelihood: log L of points (point, dim), NumPy or JAX.
        low: lower corner of the prior.
        high: upper corner of the prior.
        log_evidence: log ∫ L p dx, p the uniform prior.
        mean: posterior mean.
        covariance: posterior covariance.
    """

    log_likelihood: Batched
    low: Float[np.ndarray, " dim"]
    high: Float[np.ndarray, " dim"]
    log_evidence: float
    mean: Float[np.ndarray, " dim"]
    covariance: Float[np.ndarray, "dim dim"]

    def log_prior(self, x: Any) -> Any:
        """Return the log of the uniform prior, -inf outside the box; NumPy or JAX."""
        xp = x.__array_namespace__()
        inside = xp.all((x >= self.low) & (x <= self.high), axis=-1)
        return xp.where(inside, -float(np.log(self.high - self.low).sum()), -xp.inf)

    def log_posterior(self, x: Any) -> Any:
        """Return log(L p), not normalised; NumPy or JAX."""
        return self.log_likelihood(x) + self.log_prior(x)

    def draw_prior(self, rng: np.random.Generator, number: int) -> Float[np.ndarray, "particle dim"]:
        """Return independent draws of the prior."""
        return rng.uniform(self.low, self.high, size=(number, len(self.low)))


def gaussian(mean: Float[np.ndarray, " dim"], covariance: Float[np.ndarray, "dim dim"]) -> KnownPosterior:
    """Return an unnormalised Gaussian, exp(-½ …), in a box of ±9 standard deviations (1e-18 of the mass is cut)."""
    sd = np.sqrt(np.diagonal(covariance))
    precision = np.linalg.inv(covariance)
    low, high = mean - 9 * sd, mean + 9 * sd
    log_mass = 0.5 * float(np.linalg.slogdet(2 * math.pi * covariance)[1])

    def log_likelihood(x: Any) -> Any:
        z = x - mean
        return -0.5 * ((z @ precision) * z).sum(axis=-1)

    return KnownPosterior(log_likelihood, low, high, log_mass - _log_volume(low, high), mean, covariance)


def banana(*, centre: float, sd: float, bend: float, width: float) -> KnownPosterior:
    """Return a curved ridge, x ~ N(centre, sd²), y | x ~ N(bend·x², width²), in a box that cuts off nothing relevant.

    E y = bend (centre² + sd²), Var y = width² + bend² (4 centre² sd² + 2 sd⁴), Cov(x, y) = 2 bend·centre·sd².
    """
    reach = abs(centre) + 8 * sd
    top = abs(bend) * reach**2 + 8 * width
    low, high = np.array([centre - 8 * sd, -top]), np.array([centre + 8 * sd, top])
    mean = np.array([centre, bend * (centre**2 + sd**2)])
    mixed = 2 * bend * centre * sd**2
    spread = width**2 + bend**2 * (4 * centre**2 * sd**2 + 2 * sd**4)
    covariance = np.array([[sd**2, mixed], [mixed, spread]])

    def log_likelihood(x: Any) -> Any:
        return -0.5 * ((x[:, 0] - centre) / sd) ** 2 - 0.5 * ((x[:, 1] - bend * x[:, 0] ** 2) / width) ** 2

    log_mass = math.log(2 * math.pi * sd * width)
    return KnownPosterior(log_likelihood, low, high, log_mass - _log_volume(low, high), mean, covariance)


def truncated_gaussian(
    mean: Float[np.ndarray, " dim"],
    sd: Float[np.ndarray, " dim"],
    low: Float[np.ndarray, " dim"],
    high: Float[np.ndarray, " dim"],
) -> KnownPosterior:
    """Return independent unnormalised Gaussians exp(-½ z²) cut by the box."""
    a, b = (low - mean) / sd, (high - mean) / sd
    mass = special.ndtr(b) - special.ndtr(a)
    slope = (_standard_density(a) - _standard_density(b)) / mass
    bend = (a * _standard_density(a) - b * _standard_density(b)) / mass
    log_mass = float(np.log(math.sqrt(2 * math.pi) * sd * mass).sum())

    def log_likelihood(x: Any) -> Any:
        return -0.5 * (((x - mean) / sd) ** 2).sum(axis=-1)

    covariance = np.diag(sd**2 * (1 + bend - slope**2))
    return KnownPosterior(log_likelihood, low, high, log_mass - _log_volume(low, high), mean + sd * slope, covariance)


def linear_exponential(rate: Float[np.ndarray, " dim"]) -> KnownPosterior:
    """Return L = exp(-rate·x) on the unit cube, rates not zero; if rates are large, all mass is in a corner."""
    mass = -np.expm1(-rate) / rate
    mean = 1 / rate - 1 / np.expm1(rate)
    variance = 1 / rate**2 - np.exp(rate) / np.expm1(rate) ** 2
    corners = np.zeros(len(rate)), np.ones(len(rate))

    def log_likelihood(x: Any) -> Any:
        return -(x * rate).sum(axis=-1)

    return KnownPosterior(log_likelihood, *corners, float(np.log(mass).sum()), mean, np.diag(variance))


def uniform(low: Float[np.ndarray, " dim"], high: Float[np.ndarray, " dim"]) -> KnownPosterior:
    """Return L = 1: the posterior is the prior."""

    def log_likelihood(x: Any) -> Any:
        return 0.0 * x[:, 0]

    return KnownPosterior(log_likelihood, low, high, 0.0, 0.5 * (low + high), np.diag((high - low) ** 2 / 12))


def _standard_density(z: Float[np.ndarray, " dim"]) -> Float[np.ndarray, " dim"]:
    return np.exp(-0.5 * z**2) / math.sqrt(2 * math.pi)


def _log_volume(low: Float[np.ndarray, " dim"], high: Float[np.ndarray, " dim"]) -> float:
    return float(np.log(high - low).sum())
