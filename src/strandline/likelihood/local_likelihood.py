"""Log-likelihoods of fields near the one that fits best, from residuals that are polynomials of the field.

They take a hundredth of the time of comparing interfaces, and lead a sampler near the posterior. What they miss is
weighed off against the measure itself.

A parabola of log L around each predicted field yields the mean of L over Gaussian fields. For residuals r + Jz with
noise covariance C, z the deviation of the modes' coefficients from the predicted ones and V their variances,

    E[L]/L = exp(½ gᵀ(I + H)⁻¹g) / √det(I + H),   H = V½ JᵀC⁻¹J V½,   g = -V½ JᵀC⁻¹r,

which is N(r; 0, C + JVJᵀ) / N(r; 0, C) by the matrix determinant lemma and Woodbury's identity (Rasmussen and Williams
2006, Eqs. A.9 and A.10). Where the parabola is not exact, draws weigh off what it misses: half of them from the
Gaussian that it leads to, half from the field itself, which bounds their weights, with the parabola's own mean as the
control (Hesterberg 1995).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp, softmax
from scipy.stats import norm, qmc

from strandline.discrepancy import Discrepancy, FollowsOffsets, JointErrors, NormalOffset, Points, places_of, sums_of
from strandline.interface import ErrorModel, Interface, Observation, PointErrors
from strandline.likelihood.interfaces import Compared, compared
from strandline.likelihood.linearised_residuals import BENT, NearField, linearise
from strandline.surrogate import FieldPrediction, FieldSurrogate

Values = Float[np.ndarray, " point"]
Modes = Float[np.ndarray, "point mode"]
Matrix = Float[np.ndarray, "term term"]
Numbers = tuple[Float[np.ndarray, "draw mode"], Float[np.ndarray, "draw rest"]]
"""Standard normal numbers that fields are drawn with: of the modes, and of what they leave over."""
TOGETHER = 1024  # points whose matrices are computed together
TINY = 1e-300  # keeps quotients finite
LEAST = 1e-6  # least second derivative of a fitted parabola, as a share of the largest: none bends upwards
Tail = Float[np.ndarray, "point rest"]
BLOCK = 1 << 22  # residuals computed together
ROWS = 512  # offsets tried one by one together
SMALL, NOTHING = 1e-4, 1e-12  # relative step of d² to see how log L changes; least size of offsets, mm


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
        parts = [self._block(coefficients[k : k + TOGETHER]) for k in range(0, len(coefficients), TOGETHER)]
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


@dataclass(frozen=True, eq=False)
class Mixture:
    """log Σ_k w_k exp(-½ d_k²), d_k² = rᵀ C_k⁻¹ r with C_k = κ_k V + B S_k² Bᵀ, V and S_k diagonal.

    B, `shared`, is what one unit of each shared error does to the signed distances, mm; the global errors of `joint`
    are its first columns. V is `local`, κ are `levels`, mm², and S `scales`.
    """

    joint: JointErrors
    local: Float[np.ndarray, " seen"]
    shared: Float[np.ndarray, "seen error"]
    levels: Float[np.ndarray, " level"]
    scales: Float[np.ndarray, "level error"]
    log_weights: Float[np.ndarray, " level"]

    def one(self, interfaces: Mapping[str, Interface]) -> float:
        points = {seen.condition: interfaces[seen.condition].points[None] for seen in self.joint.observations}
        return float(self.many(points, interfaces)[0])

    def many(self, points: Points, templates: Mapping[str, Interface]) -> Float[np.ndarray, " run"]:
        """Return log L of each run, given its points by condition."""
        return self.of_sums(*sums_of(self.joint, points, templates, self.model, self._global_errors))

    @cached_property
    def model(self) -> ErrorModel:
        return ErrorModel(self.local, self.shared)

    def _global_errors(self, products: Float[np.ndarray, "run error"]) -> Float[np.ndarray, "run error"]:
        """Return the most probable global errors at the likeliest level; other shared errors stay as they are."""
        likeliest = int(np.argmax(self.log_weights))
        level, scale = self.levels[likeliest], self.scales[likeliest]
        inverse = np.linalg.inv(level * np.eye(len(scale)) + scale[:, None] * self.model.gram * scale)
        found = (products * scale) @ inverse * scale
        found[:, self.joint.model.shared.shape[1] :] = 0.0
        return np.asarray(found)

    def of_sums(
        self, squares: Float[np.ndarray, " run"], products: Float[np.ndarray, "run error"]
    ) -> Float[np.ndarray, " run"]:
        """Return log L from Σ r²/V and e = BᵀV⁻¹r, for d² = Σ r²/(κV) - (Se)ᵀ (κ²I + κ S G S)⁻¹ Se, G = BᵀV⁻¹B."""
        values = np.empty((len(self.levels), len(squares)))
        for k, (level, inverse) in enumerate(zip(self.levels, self._inverses, strict=True)):
            values[k] = squares / level - ((products @ inverse) * products).sum(axis=1)
        return np.asarray(logsumexp(self.log_weights[:, None] - 0.5 * values, axis=0))

    def weights_of_sums(
        self, gram: Float[np.ndarray, "term term"], products: Float[np.ndarray, "term error"]
    ) -> Float[np.ndarray, "term term"]:
        """Return the mean of FᵀC_k⁻¹F over the components, each as likely as the first column of F makes it.

        It follows from `gram`, FᵀV⁻¹F, and `products`, FᵀV⁻¹B.
        """
        inverses = zip(self.levels, self._inverses, strict=True)
        each = np.array([gram / level - products @ inverse @ products.T for level, inverse in inverses])
        return np.asarray(np.tensordot(softmax(self.log_weights - 0.5 * each[:, 0, 0]), each, axes=1))

    @property
    def _inverses(self) -> Float[np.ndarray, "level error error"]:
        """S_k (κ_k²I + κ_k S_k G S_k)⁻¹ S_k."""
        G = self.model.gram
        S, levels = self.scales, self.levels[:, None, None]
        inner = levels**2 * np.eye(len(G)) + levels * S[:, :, None] * G * S[:, None, :]
        return np.asarray(S[:, :, None] * np.linalg.inv(inner) * S[:, None, :])


@dataclass(frozen=True, eq=False)
class OfStatedErrors:
    """log L = -½ rᵀC⁻¹r of signed distances r with stated errors."""

    field: NearField
    model: ErrorModel

    def log_likelihood(self, coefficients: Modes, tail: Tail | None = None) -> Values:
        """Return log L of the interfaces with these coefficients of the modes, mm, and of what they leave over."""
        return np.asarray(-0.5 * self.model.square_of(*self.field.sums(coefficients, tail)))

    @cached_property
    def parabola(self) -> NearParabola:
        across = self.model.shared_errors(self.field.products) @ self.field.products.T
        return NearParabola(self.field, self.field.gram - across)


@dataclass(frozen=True, eq=False)
class OfMixture:
    """Log-likelihood of signed distances whose errors are inferred."""

    field: NearField
    mixture: Mixture

    def log_likelihood(self, coefficients: Modes, tail: Tail | None = None) -> Values:
        return self.mixture.of_sums(*self.field.sums(coefficients, tail))

    @cached_property
    def parabola(self) -> NearParabola:
        """The mean over the components, as likely as they are at the best fit."""
        weights = self.mixture.weights_of_sums(self.field.gram, self.field.products)
        best = float(self.log_likelihood(self.field.at[None])[0])
        return NearParabola(self.field, weights, best + 0.5 * float(weights[0, 0]))


@dataclass(frozen=True, eq=False)
class _ByOffsets:
    """log L of one observation by a measure of offsets from simulated interfaces with so many nodes."""

    compared: Compared
    nodes: int

    def log_likelihood(self, offsets: Float[np.ndarray, "draw seen"]) -> Values:
        return np.asarray(self.compared.noise.log_density(self._squares(offsets)))

    def weights(self, r: Float[np.ndarray, " seen"]) -> Float[np.ndarray, " seen"]:
        """Return w with log L ≈ constant - ½ Σ w r² near some offsets, whose typical size each of them has at least."""
        size = np.maximum(np.abs(r), max(float(np.sqrt(np.mean(r**2))), NOTHING))
        rows = (size * np.eye(min(ROWS, len(r) - k), len(r), k) for k in range(0, len(r), ROWS))
        squares = np.concatenate([self._squares(some) for some in rows])
        d2 = float(self._squares(size[None])[0])
        density = self.compared.noise.log_density(np.array([d2, (1 + SMALL) * d2]))
        return np.asarray(2 * squares / size**2 * float(density[0] - density[1]) / (SMALL * d2))

    def _squares(self, offsets: Float[np.ndarray, "draw seen"]) -> Values:
        measure = self.compared.measure
        assert isinstance(measure, FollowsOffsets)
        squares = measure.of_offsets(offsets, self.compared.observation.interface, self.nodes)
        assert squares is not None
        return squares


@dataclass(frozen=True, eq=False)
class OfOffsets:
    """Log-likelihood by a measure that nearly follows from the signed distances, with the place of each observation."""

    field: NearField
    parts: tuple[tuple[_ByOffsets, slice], ...]

    def log_likelihood(self, coefficients: Modes, tail: Tail | None = None) -> Values:
        size, found = max(BLOCK // len(self.field.residuals), 1), []
        for some in (slice(k, k + size) for k in range(0, len(coefficients), size)):
            offsets = self.field.offsets(coefficients[some], None if tail is None else tail[some])
            found.append(sum(one.log_likelihood(offsets[:, part]) for one, part in self.parts))
        return np.concatenate(found)

    @cached_property
    def parabola(self) -> NearParabola:
        """The same weights everywhere: those that square and derivative of d² have at the best fit."""
        r = self.field.residuals
        weights = np.concatenate([one.weights(r[part]) for one, part in self.parts])
        factors = self.field.factors
        gram = factors.T @ (factors * weights[:, None])
        best = float(self.log_likelihood(self.field.at[None])[0])
        return NearParabola(self.field, gram, best + 0.5 * float(gram[0, 0]))


Nearby = OfStatedErrors | OfMixture | OfOffsets
"""A log-likelihood of fields near the one that fits best, and a parabola of the residuals that is like it there."""


def nearby(
    surrogate: FieldSurrogate, observations: tuple[Observation, ...], measure: Discrepancy, shared: JointErrors | None
) -> Nearby | None:
    """Return the log-likelihood near the best fit; None for surfaces, and for measures that do not follow offsets."""
    if any(seen.interface.dim != 2 for seen in observations):
        return None
    errors = tuple(seen.known for seen in observations if seen.known)
    if shared is not None or (isinstance(measure, NormalOffset) and len(errors) == len(observations)):
        joint = shared or JointErrors(observations, errors)
        field = linearise(surrogate, joint).field
        return OfStatedErrors(field, joint.model) if field.finite else None
    nodes = tuple(len(surrogate.layouts[seen.condition].template.points) for seen in observations)
    each = tuple(compared(seen, measure, number) for seen, number in zip(observations, nodes, strict=True))
    if not all(follows_offsets(one.measure, one.observation, number) for one, number in zip(each, nodes, strict=True)):
        return None
    equal = JointErrors(observations, tuple(PointErrors(1.0) for _ in observations))
    field = linearise(surrogate, equal).field
    places = places_of(len(seen.interface.points) for seen in observations)
    parts = ((_ByOffsets(one, number), place) for one, number, place in zip(each, nodes, places, strict=True))
    return OfOffsets(field, tuple(parts)) if field.finite else None


def follows_offsets(measure: Discrepancy, observation: Observation, nodes: int) -> bool:
    """Return whether the measure nearly follows from the signed distances of the observed points."""
    if not isinstance(measure, FollowsOffsets):
        return False
    seen = observation.interface
    return measure.of_offsets(np.zeros((1, len(seen.points))), seen, nodes) is not None
