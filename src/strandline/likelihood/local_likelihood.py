"""Log-likelihoods of fields near the one that fits best, from residuals that are polynomials of the field.

They take a hundredth of the time of comparing interfaces, and lead a sampler near the posterior. What they miss is
weighed off against the measure itself.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp, softmax

from strandline.discrepancy import Discrepancy, FollowsOffsets, JointErrors, NormalOffset, Points, places_of, sums_of
from strandline.interface import ErrorModel, Interface, Observation, PointErrors
from strandline.likelihood.interfaces import Compared, compared
from strandline.likelihood.linearised_residuals import NearField, linearise
from strandline.likelihood.parabolas import Modes, NearParabola, Values
from strandline.surrogate import FieldSurrogate

Tail = Float[np.ndarray, "point rest"]
BLOCK = 1 << 22  # residuals computed together
ROWS = 512  # offsets tried one by one together
SMALL, NOTHING = 1e-4, 1e-12  # relative step of d² to see how log L changes; least size of offsets, mm


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
