"""Adaptive importance sampling: a mixture of Student distributions follows a posterior, round by round.

The points of all rounds count. Each is weighted by the target's density over that of everything drawn from so far
together (deterministic mixture; Cornuet et al. 2012), so points of the first sample, which is spread over the whole
prior, bound the weights. The mixture is fitted to the weighted points by expectation maximisation (Cappé et al. 2008);
as long as only a few of them count, to a power of the weights that lets enough of them count.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular
from scipy.special import gammaln

from strandline.posterior.weighted import Weighted

__all__ = ["ENOUGH", "FREEDOM", "Pool", "StudentMixture", "effective_size", "fitted", "followed"]

ENOUGH = 400.0
"""Effective sample size at which sampling ends."""
ROUNDS = 8
"""Largest number of rounds."""
DRAWS, MANY_INPUTS_DRAWS = 1000, 2000
"""Points of a round, for up to three inputs and for more."""
FREEDOM = 5.0
"""Degrees of freedom of the Student distributions: tails heavier than those of most posteriors."""
MOST_PARTS = 4
"""Largest number of distributions in the mixture."""
FITTED, OF_PART = 20.0, 10.0
"""Effective points that a mixture, and each part of it, is fitted to, per number of inputs + 1."""
STEPS = 10
"""Steps of expectation maximisation."""
FLOOR = 1e-9
"""Smallest variance of a part, relative to that of the points it is fitted to."""
NEGLIGIBLE = 1e-9
"""Weight, relative to the largest, below which a point is left out of a fit."""

Points = Float[np.ndarray, "point dim"]
Values = Float[np.ndarray, " point"]


@dataclass(frozen=True, eq=False)
class StudentMixture:
    """A mixture of multivariate Student distributions.

    Args:
        shares: Probability of each part, shape (part,).
        means: Centres, shape (part, dim).
        factors: Lower Cholesky factors of their scale matrices, shape (part, dim, dim).
    """

    shares: Float[np.ndarray, " part"]
    means: Float[np.ndarray, "part dim"]
    factors: Float[np.ndarray, "part dim dim"]

    def squares(self, x: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, "part point"]:
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

    def log_density(self, x: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, " point"]:
        """Return the log density."""
        return _log_sum(self.log_parts(self.squares(x)))

    def draw(self, number: int, random: np.random.Generator) -> Float[np.ndarray, "draw dim"]:
        """Return draws."""
        which = random.choice(len(self.shares), size=number, p=self.shares)
        normal = random.standard_normal((number, self.means.shape[1]))
        stretch = np.sqrt(FREEDOM / random.chisquare(FREEDOM, number))
        steps = np.einsum("dij,dj->di", self.factors[which], normal)
        return np.asarray(self.means[which] + stretch[:, None] * steps)


@dataclass(frozen=True, eq=False)
class Pool:
    """All points drawn so far: the first sample, then those of each mixture.

    Args:
        x: Points, shape (point, dim).
        log_counts: Logarithms of how many draws each point stands for; -inf leaves it out.
        log_first: Normalised log density of the distribution that the first sample represents.
        log_target: Log density of the target, up to a constant.
        number: Number of draws that the first sample stands for.
        mixtures: Mixtures drawn from since, with the number of draws from each.
    """

    x: Float[np.ndarray, "point dim"]
    log_counts: Float[np.ndarray, " point"]
    log_first: Float[np.ndarray, " point"]
    log_target: Float[np.ndarray, " point"]
    number: int
    mixtures: tuple[tuple[StudentMixture, int], ...] = ()

    @property
    def log_ratios(self) -> Float[np.ndarray, " point"]:
        """Log weights of the target before they are normalised: the sum of the weights estimates its integral."""
        drawn = [math.log(n) + mixture.log_density(self.x) for mixture, n in self.mixtures]
        together = _log_sum(np.stack([math.log(self.number) + self.log_first, *drawn]))
        return np.asarray(self.log_counts + self.log_target - together)

    @property
    def log_integral(self) -> float:
        """Logarithm of the integral of the target, with the constant that its log density has."""
        return float(_log_sum(self.log_ratios))

    @property
    def log_weights(self) -> Float[np.ndarray, " point"]:
        """Normalised log weights of the target."""
        ratios = self.log_ratios
        return np.asarray(ratios - _log_sum(ratios))

    @property
    def weighted(self) -> Weighted:
        """The points with their weights."""
        return Weighted(self.x, np.exp(self.log_weights))

    def extended(self, mixture: StudentMixture, x: Points, log_first: Values, log_target: Values) -> "Pool":
        """Return the pool with draws from a mixture."""
        return replace(
            self,
            x=np.concatenate([self.x, x]),
            log_counts=np.concatenate([self.log_counts, np.zeros(len(x))]),
            log_first=np.concatenate([self.log_first, log_first]),
            log_target=np.concatenate([self.log_target, log_target]),
            mixtures=(*self.mixtures, (mixture, len(x))),
        )


def followed(
    pool: Pool,
    log_densities: Callable[[Points], tuple[Values, Values]],
    random: np.random.Generator,
    *,
    enough: float = ENOUGH,
) -> Pool | None:
    """Return a pool with an effective sample size of `enough` draws of the target; None if that is not reached.

    Args:
        pool: The first sample.
        log_densities: Function that returns `log_first` and `log_target` of points, -inf outside the prior.
        random: Random numbers.
        enough: Effective sample size to reach.
    """
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


def effective_size(log_weights: Float[np.ndarray, " point"]) -> float:
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


def _begun(
    x: Points, weights: Values, spread: Float[np.ndarray, "dim dim"], number: int, random: np.random.Generator
) -> StudentMixture:
    """Return parts of equal shares around points that are far from each other (k-means++)."""
    factor = np.linalg.cholesky(spread)
    z = solve_triangular(factor, x.T, lower=True, check_finite=False).T
    chosen = [int(random.choice(len(x), p=weights))]
    while len(chosen) < number:
        nearest = np.min([np.sum((z - z[k]) ** 2, axis=1) for k in chosen], axis=0)
        chosen.append(int(random.choice(len(x), p=weights * nearest / (weights @ nearest))))
    factors = np.stack([factor] * number) / number ** (1 / x.shape[1])
    return StudentMixture(np.full(number, 1 / number), x[chosen], factors)


def _improved(
    mixture: StudentMixture, x: Points, weights: Values, effective: float, floor: Float[np.ndarray, "dim dim"]
) -> StudentMixture:
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
