"""Adaptive importance sampling: a mixture of Student distributions follows a posterior, round by round.

The points of all rounds count. Each is weighted by the target's density over that of everything drawn from so far
together (deterministic mixture; Cornuet et al. 2012), so points of the first sample, which is spread over the whole
prior, bound the weights. The mixture is fitted to the weighted points by expectation maximisation (Cappé et al. 2008);
as long as only a few of them count, to a power of the weights that lets enough of them count.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import solve_triangular
from scipy.special import gammaln, log_softmax

from strandline.design import SAMPLING, sobol
from strandline.parameters import ParameterSpace
from strandline.posterior import Weighted
from strandline.smc import OnHost, SMCResult, sample

ENOUGH = 400.0  # effective sample size at which sampling ends
ROUNDS = 8  # largest number of rounds
DRAWS, MANY_INPUTS_DRAWS = 1000, 2000  # points of a round, for up to three inputs and for more
FREEDOM = 5.0  # degrees of freedom of the Student distributions: tails heavier than those of most posteriors
MOST_PARTS = 4  # largest number of distributions in the mixture
FITTED, OF_PART = 20.0, 10.0  # effective points that a mixture, and each part, is fitted to, per number of inputs + 1
STEPS = 10  # steps of expectation maximisation
FLOOR = 1e-9  # smallest variance of a part, relative to that of the points it is fitted to
NEGLIGIBLE = 1e-9  # weight, relative to the largest, below which a point is left out of a fit
PARTICLES = 2000  # particles of the tempered sampler, which takes over where importance sampling does not get there
SCRAMBLE = 0  # seed that scrambles the Sobol sequence of the prior's draws; the plain one begins at a corner
By = Literal["importance", "smc"]
Points = Float[np.ndarray, "point dim"]
Values = Float[np.ndarray, " point"]
Matrix = Float[np.ndarray, "dim dim"]
Densities = Callable[[Points], tuple[Values, Values]]
"""Function that returns the log densities of the prior and of the posterior, each of shape (point,)."""


def only_inside(inside: Callable[[Points], Bool[np.ndarray, " point"]], densities: Densities) -> Densities:
    """Return densities that are evaluated where `inside` says so, and are -∞ elsewhere."""

    def log_densities(x: Points) -> tuple[Values, Values]:
        first, target = np.full(len(x), -np.inf), np.full(len(x), -np.inf)
        some = inside(x)
        if some.any():
            first[some], target[some] = densities(x[some])
        return first, target

    return log_densities


def prior_and_posterior(space: ParameterSpace, log_likelihood: Callable[[Points], Values]) -> Densities:
    """Return the log densities of the prior, and of likelihood times prior, which count where the prior is above 0."""

    def both(x: Points) -> tuple[Values, Values]:
        first = np.asarray(space.log_prior(x))
        return first, first + log_likelihood(x)

    return only_inside(space.inside, both)


@dataclass(frozen=True, eq=False)
class StudentMixture:
    """A mixture of multivariate Student distributions, with lower Cholesky factors of their scale matrices."""

    shares: Float[np.ndarray, " part"]
    means: Float[np.ndarray, "part dim"]
    factors: Float[np.ndarray, "part dim dim"]

    def squares(self, x: Points) -> Float[np.ndarray, "part point"]:
        """Return the squared distance of each point from each centre, in the scale of the part."""
        parts = zip(self.means, self.factors, strict=True)
        scaled = [solve_triangular(factor, (x - mean).T, lower=True, check_finite=False) for mean, factor in parts]
        return np.stack([np.einsum("dp,dp->p", z, z) for z in scaled])

    def log_parts(self, squares: Float[np.ndarray, "part point"]) -> Float[np.ndarray, "part point"]:
        """Return the log density of each part times its share, where the squared distances from the centres are."""
        dim = self.means.shape[1]
        norm = gammaln(0.5 * (FREEDOM + dim)) - gammaln(0.5 * FREEDOM) - 0.5 * dim * math.log(math.pi * FREEDOM)
        sizes = np.log(np.diagonal(self.factors, axis1=1, axis2=2)).sum(axis=1)
        tails = 0.5 * (FREEDOM + dim) * np.log1p(squares / FREEDOM)
        return np.asarray((np.log(self.shares) + norm - sizes)[:, None] - tails)

    def log_density(self, x: Points) -> Values:
        return _log_sum(self.log_parts(self.squares(x)))

    def draw(self, number: int, random: np.random.Generator) -> Float[np.ndarray, "draw dim"]:
        which = random.choice(len(self.shares), size=number, p=self.shares)
        normal = random.standard_normal((number, self.means.shape[1]))
        stretch = np.sqrt(FREEDOM / random.chisquare(FREEDOM, number))
        steps = np.einsum("dij,dj->di", self.factors[which], normal)
        return np.asarray(self.means[which] + stretch[:, None] * steps)


@dataclass(frozen=True, eq=False)
class Pool:
    """All points drawn so far: the first sample, then those of each mixture, with the number of its draws.

    `log_counts` are logarithms of how many draws each point stands for; -inf leaves it out. `log_first` is the
    normalised log density of what the first sample, `number` draws, represents; `log_target` is not normalised.
    """

    x: Points
    log_counts: Values
    log_first: Values
    log_target: Values
    number: int
    mixtures: tuple[tuple[StudentMixture, int], ...] = ()

    @property
    def log_ratios(self) -> Values:
        """Log weights of the target before they are normalised: the sum of the weights estimates its integral."""
        drawn = [math.log(n) + mixture.log_density(self.x) for mixture, n in self.mixtures]
        together = _log_sum(np.stack([math.log(self.number) + self.log_first, *drawn]))
        return np.asarray(self.log_counts + self.log_target - together)

    @property
    def log_weights(self) -> Values:
        ratios = self.log_ratios
        return np.asarray(ratios - _log_sum(ratios))

    @property
    def log_likelihood(self) -> Values:
        """Log density of the target less that of the first sample, -∞ where this is 0."""
        inside = np.isfinite(self.log_first)
        return np.where(inside, self.log_target - np.where(inside, self.log_first, 0.0), -np.inf)

    @property
    def weighted(self) -> Weighted:
        return Weighted(self.x, np.exp(self.log_weights))

    def extended(self, mixture: StudentMixture, x: Points, log_first: Values, log_target: Values) -> "Pool":
        """Return the pool with the draws `x`, shape (draw, dim), of one more mixture; densities have shape (draw,)."""
        return replace(
            self,
            x=np.concatenate([self.x, x]),
            log_counts=np.concatenate([self.log_counts, np.zeros(len(x))]),
            log_first=np.concatenate([self.log_first, log_first]),
            log_target=np.concatenate([self.log_target, log_target]),
            mixtures=(*self.mixtures, (mixture, len(x))),
        )


class Sampled(NamedTuple):
    """Draws of a posterior with their normalised log weights and log-likelihoods, its log-evidence, and its sampler."""

    x: Points
    log_weights: Values
    log_likelihood: Values
    log_evidence: float
    by: By


def prior_pool(space: ParameterSpace, log_densities: Densities, number: int) -> Pool:
    """Return a number of draws of the prior with their log densities."""
    x = space.prior_quantiles(sobol(number, space.dim, scramble=SCRAMBLE))
    return Pool(x, np.zeros(number), *log_densities(x), number)


def importance_or_smc(
    pool: Pool,
    log_densities: Densities,
    space: ParameterSpace,
    log_likelihood: Callable[[Points], Values],
    random: np.random.Generator,
    *,
    enough: float = ENOUGH,
) -> Sampled:
    """Return draws of a posterior by importance; by tempering from the prior of `space` if that does not get there.

    `log_likelihood` leads from this prior to the posterior; other arguments are those of `followed`.
    """
    found = followed(pool, log_densities, random, enough=enough)
    if found is not None:
        return Sampled(
            found.x, found.log_weights, found.log_likelihood, float(_log_sum(found.log_ratios)), "importance"
        )
    drawn = tempered(log_likelihood, space, random)
    values = np.asarray(drawn.log_likelihood)
    return Sampled(drawn.positions, np.asarray(log_softmax(drawn.log_weights)), values, drawn.log_evidence, "smc")


def tempered(
    log_likelihood: Callable[[Points], Values], space: ParameterSpace, random: np.random.Generator
) -> SMCResult:
    """Return particles of a posterior by tempering from draws of the prior of `space`."""
    initial = space.prior_quantiles(random.random((PARTICLES, space.dim)))
    key = jax.random.key(int(random.integers(2**32)))
    return sample(key, OnHost(log_likelihood), space.log_prior, initial, settings=SAMPLING)


def followed(
    pool: Pool, log_densities: Densities, random: np.random.Generator, *, enough: float = ENOUGH
) -> Pool | None:
    """Return a pool with an effective sample size of `enough` draws of the target; None if that is not reached."""
    draws = DRAWS if pool.x.shape[1] <= 3 else MANY_INPUTS_DRAWS
    for rounds_left in range(ROUNDS, -1, -1):
        log_weights = pool.log_weights
        if effective_size(log_weights) >= enough:
            return pool
        if rounds_left:
            mixture = fitted(pool.x, log_weights, random)
            x = mixture.draw(draws, random)
            pool = pool.extended(mixture, x, *log_densities(x))
    return None


def effective_size(log_weights: Values) -> float:
    """Return (Σ w)² / Σ w²."""
    top = log_weights.max()
    if top == -np.inf:
        return 0.0
    weights = np.exp(log_weights - top)
    return float(weights.sum() ** 2 / (weights @ weights))


def _log_sum(values: Float[np.ndarray, "part *point"]) -> Float[np.ndarray, "*point"]:
    """Return log Σ exp over the first axis; SciPy's takes seven times as long for arrays as small as these."""
    top = values.max(axis=0)
    safe = np.where(top == -np.inf, 0.0, top)
    with np.errstate(divide="ignore"):
        return np.asarray(safe + np.log(np.exp(values - safe).sum(axis=0)))


def fitted(x: Points, log_weights: Values, random: np.random.Generator) -> StudentMixture:
    """Return a mixture fitted to weighted points, or to a power of the weights if only a few count."""
    dim = x.shape[1]
    known = np.isfinite(log_weights)
    log_weights = _tempered(log_weights[known], FITTED * (dim + 1))
    weights = np.exp(log_weights - log_weights.max())
    some = weights > NEGLIGIBLE
    x, weights = x[known][some], weights[some] / weights[some].sum()
    effective = float(1 / np.sum(weights**2))
    number = int(np.clip(1e-3 + effective / (OF_PART * (dim + 1)), 1, MOST_PARTS))  # tempering aims at a whole number
    spread = Weighted(x, weights).covariance
    floor = FLOOR * np.diag(np.diag(spread))
    mixture = _begun(x, weights, spread + floor, number, random)
    for _ in range(STEPS):
        mixture = _improved(mixture, x, weights, effective, floor)
    return mixture


def _tempered(log_weights: Values, least: float) -> Values:
    """Return the log weights times the largest factor up to 1 that leaves an effective sample size of `least`."""
    if effective_size(log_weights) >= least:
        return log_weights
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if effective_size(middle * log_weights) >= least else (low, middle)
    return low * log_weights


def _begun(x: Points, weights: Values, spread: Matrix, number: int, random: np.random.Generator) -> StudentMixture:
    """Return parts of equal shares around points that are far from each other (k-means++)."""
    factor = np.linalg.cholesky(spread)
    z = solve_triangular(factor, x.T, lower=True, check_finite=False).T
    chosen = [int(random.choice(len(x), p=weights))]
    while len(chosen) < number:
        nearest = np.min([np.sum((z - z[k]) ** 2, axis=1) for k in chosen], axis=0)
        chosen.append(int(random.choice(len(x), p=weights * nearest / (weights @ nearest))))
    factors = np.stack([factor] * number) / number ** (1 / x.shape[1])
    return StudentMixture(np.full(number, 1 / number), x[chosen], factors)


def _improved(mixture: StudentMixture, x: Points, weights: Values, effective: float, floor: Matrix) -> StudentMixture:
    """Return the mixture after one step of expectation maximisation, without parts that hardly any points belong to."""
    dim = x.shape[1]
    squares = mixture.squares(x)
    log_parts = mixture.log_parts(squares)
    belongs = weights * np.exp(log_parts - _log_sum(log_parts))
    alive = effective * belongs.sum(axis=1) > dim + 1
    alive[np.argmax(belongs.sum(axis=1))] = True
    belongs = belongs[alive]
    near = belongs * (FREEDOM + dim) / (FREEDOM + squares[alive])
    means = near @ x / near.sum(axis=1, keepdims=True)
    offsets = x - means[:, None]
    shares = belongs.sum(axis=1)
    scatter = (near[:, :, None] * offsets).swapaxes(1, 2) @ offsets / shares[:, None, None]
    return StudentMixture(shares / shares.sum(), means, np.linalg.cholesky(scatter + floor))
