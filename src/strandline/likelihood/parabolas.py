"""Log-likelihoods as parabolas of the field around each predicted one, and their means over Gaussian fields.

For residuals r + Jz with noise covariance C, z the deviation of the modes' coefficients from the predicted ones and V
their variances,

    E[L]/L = exp(½ gᵀ(I + H)⁻¹g) / √det(I + H),   H = V½ JᵀC⁻¹J V½,   g = -V½ JᵀC⁻¹r,

which is N(r; 0, C + JVJᵀ) / N(r; 0, C) by the matrix determinant lemma and Woodbury's identity (Rasmussen and Williams
2006, Eqs. A.9 and A.10). Where the parabola is not exact, draws weigh off what it misses: half of them from the
Gaussian that it leads to, half from the field itself, which bounds their weights, with the parabola's own mean as the
control (Hesterberg 1995).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp
from scipy.stats import norm, qmc

from strandline.likelihood.linearised_residuals import BENT, NearField
from strandline.surrogate import FieldPrediction

Values = Float[np.ndarray, " point"]
Modes = Float[np.ndarray, "point mode"]
Matrix = Float[np.ndarray, "term term"]
Numbers = tuple[Float[np.ndarray, "draw mode"], Float[np.ndarray, "draw rest"]]
"""Standard normal numbers that fields are drawn with: of the modes, and of what they leave over."""
BLOCK = 1024  # points whose matrices are computed together
TINY = 1e-300  # keeps quotients finite
LEAST = 1e-6  # least second derivative of a fitted parabola, as a share of the largest: none bends upwards


@dataclass(frozen=True, eq=False)
class Parabolas:
    """log L ≈ top - below + slopes·z - ½ zᵀ information z for fields z, mm, away from some predicted ones.

    `below` is at least 0, `information` positive semidefinite. No field exceeds `top`; `rest` is what the fields
    outside the modes add to log E[L].
    """

    below: Values
    slopes: Modes
    information: Float[np.ndarray, "point mode mode"]
    top: float = 0.0
    rest: float = 0.0


@dataclass(frozen=True, eq=False)
class NearParabola:
    """log L = top - ½ rᵀ W r, with residuals r near the best fit that are linear around each field; `weights` are the
    products of the columns of `field.factors`, weighed by W.
    """

    field: NearField
    weights: Matrix
    top: float = 0.0

    @cached_property
    def _integrated(self) -> tuple[Matrix, float]:
        """`weights` without what the modes leave over, which is integrated out, and the logarithm of that integral."""
        kept = len(self.weights) - self.field.tail.shape[1]
        tail = np.eye(len(self.weights) - kept) + self.weights[kept:, kept:]
        across = self.weights[:kept, kept:]
        weights = self.weights[:kept, :kept] - across @ np.linalg.solve(tail, across.T)
        return weights, -0.5 * float(np.linalg.slogdet(tail)[1])

    def parabolas(self, coefficients: Modes) -> Parabolas:
        parts = [self._block(coefficients[k : k + BLOCK]) for k in range(0, len(coefficients), BLOCK)]
        below, slopes, information = (np.concatenate(one) for one in zip(*parts, strict=True))
        return Parabolas(below, slopes, information, self.top, self._integrated[1])

    def _block(self, coefficients: Modes) -> tuple[Values, Modes, Float[np.ndarray, "point mode mode"]]:
        z, W = coefficients - self.field.at, self._integrated[0]
        number, modes = z.shape
        products, share = self.field.bending(z)
        terms = np.hstack([np.ones((number, 1)), z, share[:, None] * products])
        weighed = terms @ W
        ahead, bent, few = slice(1, 1 + modes), slice(1 + modes, None), min(modes, BENT)
        bends = share[:, None, None] * np.einsum("pmn,dn->dpm", _differentiated(few), z[:, :few])
        information = np.repeat(W[None, ahead, ahead], number, axis=0)
        across = (W[ahead, bent] @ bends.transpose(1, 0, 2).reshape(len(bends[0]), -1)).reshape(modes, number, few)
        information[:, :, :few] += across.transpose(1, 0, 2)
        information[:, :few, :] += across.transpose(1, 2, 0)
        inner = (W[bent, bent] @ bends.transpose(1, 0, 2).reshape(len(bends[0]), -1)).reshape(-1, number, few)
        information[:, :few, :few] += bends.transpose(0, 2, 1) @ inner.transpose(1, 0, 2)
        slopes = -weighed[:, ahead]
        slopes[:, :few] -= np.einsum("dp,dpm->dm", weighed[:, bent], bends)
        below = 0.5 * np.einsum("dk,dk->d", weighed, terms)
        return np.maximum(below, 0.0), slopes, information


@cache
def _differentiated(modes: int) -> Float[np.ndarray, "pair mode mode"]:
    """Return the derivatives of z_k z_l, k ≤ l, in each z_m, as factors of each z_n."""
    first, second = np.triu_indices(modes)
    unit = np.eye(modes)
    one, other = unit[first], unit[second]
    return np.asarray(one[:, :, None] * other[:, None, :] + other[:, :, None] * one[:, None, :])


@dataclass(frozen=True, eq=False)
class FittedParabola:
    """One parabola for all fields, by differences around one field; mm, and positive definite information."""

    at: Float[np.ndarray, " mode"]
    value: float
    slopes: Float[np.ndarray, " mode"]
    information: Float[np.ndarray, "mode mode"]

    @classmethod
    def fitted(
        cls, log_likelihood: Callable[[Modes], Values], at: Float[np.ndarray, " mode"], step: float
    ) -> "FittedParabola":
        """Return the parabola of a log-likelihood by central differences, mm; a flat one if they are not finite."""
        modes = len(at)
        unit, (one, other) = np.eye(modes), np.triu_indices(modes, 1)
        f = log_likelihood(at + step * np.concatenate([np.zeros((1, modes)), unit, -unit, unit[one] + unit[other]]))
        if not np.isfinite(f).all():
            return cls(at, 0.0, np.zeros(modes), TINY * unit)
        ahead, behind, both = f[1 : 1 + modes], f[1 + modes : 1 + 2 * modes], f[1 + 2 * modes :]
        information = np.diag(2 * f[0] - ahead - behind) / step**2
        information[one, other] = information[other, one] = (ahead[one] + ahead[other] - both - f[0]) / step**2
        sizes, axes = np.linalg.eigh(information)
        sizes = np.maximum(sizes, max(LEAST * float(sizes.max()), TINY))
        return cls(at, float(f[0]), (ahead - behind) / (2 * step), (axes * sizes) @ axes.T)

    def parabolas(self, coefficients: Modes) -> Parabolas:
        """Return the parabola, seen from fields with these coefficients of the modes, mm."""
        z, number = coefficients - self.at, len(coefficients)
        slopes = self.slopes - z @ self.information
        inverse = np.linalg.inv(self.information)
        below = 0.5 * np.einsum("pk,pk->p", slopes, slopes @ inverse)
        top = self.value + 0.5 * float(self.slopes @ inverse @ self.slopes)
        return Parabolas(below, slopes, np.repeat(self.information[None], number, axis=0), top)


class _Tilted:
    """The Gaussian ∝ L p of standard normal numbers u for a parabola log L: precision RRᵀ and mean (RRᵀ)⁻¹ g. `roots`
    are the standard deviations V½ of the modes, mm, `factor` is R, lower triangular, and `pulled` R⁻¹ g.
    """

    def __init__(self, parabolas: Parabolas, variance: Modes) -> None:
        self.roots = np.sqrt(variance)
        H = self.roots[:, :, None] * parabolas.information * self.roots[:, None, :]
        self.factor = np.linalg.cholesky(H + np.eye(H.shape[1]))
        self.pulled = np.linalg.solve(self.factor, (self.roots * parabolas.slopes)[:, :, None])[:, :, 0]

    @property
    def log_root(self) -> Values:
        return np.asarray(np.log(np.diagonal(self.factor, axis1=1, axis2=2)).sum(axis=1))

    def moved(self, normal: Float[np.ndarray, "draw mode"]) -> Float[np.ndarray, "point draw mode"]:
        """Return u = R⁻ᵀ(R⁻¹ g + ξ)."""
        right = (self.pulled[:, None] + normal).transpose(0, 2, 1)
        return np.asarray(np.linalg.solve(self.factor.transpose(0, 2, 1), right).transpose(0, 2, 1))

    def back(self, u: Float[np.ndarray, "draw mode"]) -> Float[np.ndarray, "point draw mode"]:
        return np.asarray(u @ self.factor - self.pulled[:, None])


def log_gain(parabolas: Parabolas, variance: Modes, log_likelihood: Values | None = None) -> Values:
    """Return log E[L] - log L for fields of these variances, mm², by the parabolas around the mean fields.

    If log L of the mean fields is known better than by the parabolas, the gain is the same share of how far it lies
    below `Parabolas.top`, so that log E[L] never exceeds that; but where a parabola lies far below log L, it is wrong
    there, and log E[L] exceeds log L no further than the parabola's own mean.
    """
    tilted = _Tilted(parabolas, variance)
    share = _share(tilted, parabolas)
    gained = share * parabolas.below
    if log_likelihood is not None:
        below, left = np.maximum(parabolas.top - log_likelihood, 0.0), parabolas.below - gained
        gained = np.minimum(share * below, np.maximum(below - left, 0.0))
    return np.asarray(gained - tilted.log_root + parabolas.rest)


def share_gained(parabolas: Parabolas, variance: Modes) -> Values:
    """Return how much of the distance of log L from its top the mean over fields gains, from 0 to 1.

    An error of log L at the mean field leaves the rest of it in log E[L].
    """
    return _share(_Tilted(parabolas, variance), parabolas)


def _share(tilted: _Tilted, parabolas: Parabolas) -> Values:
    gained = 0.5 * np.einsum("pk,pk->p", tilted.pulled, tilted.pulled)
    return np.asarray(np.minimum(gained / np.maximum(parabolas.below, TINY), 1.0))


def mean_of_draws(
    log_likelihood: Callable[[Float[np.ndarray, "draw mode"], Float[np.ndarray, "draw rest"]], Values],
    parabolas: Parabolas,
    found: FieldPrediction,
    drawn: Numbers,
) -> Values:
    """Return log E[L] at each point by draws of the field; exact, but for the tail, where log L is a parabola.

    The standard normal numbers are the same for each point; their number of draws is even.
    """
    of_modes, of_tail = drawn
    half, tilted = len(of_modes) // 2, _Tilted(parabolas, found.variance)
    number, modes = found.mean.shape
    plain = np.repeat(of_modes[None, half:], number, axis=0)
    u = np.concatenate([tilted.moved(of_modes[:half]), plain], axis=1)
    normal = np.concatenate([np.repeat(of_modes[None, :half], number, axis=0), tilted.back(of_modes[half:])], axis=1)
    fields = found.mean[:, None] + tilted.roots[:, None] * u
    values = log_likelihood(fields.reshape(-1, modes), np.tile(of_tail, (number, 1))).reshape(number, len(of_modes))
    own = -0.5 * np.einsum("pdm,pdm->pd", u, u)
    other = -0.5 * np.einsum("pdm,pdm->pd", normal, normal) + tilted.log_root[:, None]
    both = np.logaddexp(own, other)
    return np.asarray(logsumexp(values + own - both, axis=1) - logsumexp(other - both, axis=1))


@lru_cache(maxsize=8)
def numbers(draws: int, modes: int, rest: int) -> Numbers:
    """Return standard normal numbers: a Sobol sequence in the modes, each point with its opposite, in each half."""
    sobol = qmc.Sobol(modes, seed=np.random.default_rng(0)).random(draws // 2)
    of_modes = norm.ppf(np.clip(sobol, 1e-6, 1 - 1e-6))
    of_tail = np.random.default_rng(1).standard_normal((draws // 2, rest))
    first, second = slice(None, draws // 4), slice(draws // 4, None)

    def paired(rows: Float[np.ndarray, "half number"]) -> Float[np.ndarray, "draw number"]:
        return np.concatenate([rows[first], -rows[first], rows[second], -rows[second]])

    return paired(of_modes), paired(of_tail)
