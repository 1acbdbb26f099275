"""Log-likelihoods of fields near the one that fits best, from residuals that are polynomials of the field.

They take a hundredth of the time of comparing interfaces, and lead a sampler near the posterior. What they miss is
weighed off against the measure itself.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from strandline.discrepancy import Discrepancy, FollowsOffsets, NormalOffset
from strandline.interface import ErrorModel, Observation, PointErrors
from strandline.likelihood.compared import Compared, compared
from strandline.likelihood.joint_errors import JointErrors
from strandline.likelihood.linearised import linearise
from strandline.likelihood.mixture import Mixture
from strandline.likelihood.near_field import NearField
from strandline.likelihood.parabolas import NearParabola
from strandline.likelihood.shared_errors import SharedErrors
from strandline.surrogate.field import FieldSurrogate

__all__ = ["Nearby", "OfMixture", "OfOffsets", "OfStatedErrors", "follows_offsets", "nearby"]

Values = Float[np.ndarray, " point"]
Modes = Float[np.ndarray, "point mode"]
Tail = Float[np.ndarray, "point rest"]
BLOCK = 1 << 22
"""Residuals computed together."""
ROWS = 512
"""Offsets tried one by one together."""
SMALL, NOTHING = 1e-4, 1e-12
"""Relative step of d² to see how log L changes; least size of offsets, mm."""


@runtime_checkable
class Nearby(Protocol):
    """A log-likelihood of fields near the one that fits best."""

    def log_likelihood(self, coefficients: Modes, tail: Tail | None = None) -> Values:
        """Return log L of the interfaces with these coefficients of the modes, mm, and of what they leave over."""
        ...

    @property
    def parabola(self) -> NearParabola:
        """A parabola of the residuals that is like log L near the best fit."""
        ...


@dataclass(frozen=True, eq=False)
class OfStatedErrors:
    """log L = -½ rᵀC⁻¹r of signed distances r with stated errors.

    Args:
        field: The residuals near the best fit.
        model: Covariance C of the residuals.
    """

    field: NearField
    model: ErrorModel

    def log_likelihood(self, coefficients: Modes, tail: Tail | None = None) -> Values:
        """Return log L."""
        return np.asarray(-0.5 * self.model.square_of(*self.field.sums(coefficients, tail)))

    @cached_property
    def parabola(self) -> NearParabola:
        """log L itself."""
        across = self.model.shared_errors(self.field.products) @ self.field.products.T
        return NearParabola(self.field, self.field.gram - across)


@dataclass(frozen=True, eq=False)
class OfMixture:
    """Log-likelihood of signed distances whose errors are inferred.

    Args:
        field: The residuals near the best fit.
        mixture: The likelihood.
    """

    field: NearField
    mixture: Mixture

    def log_likelihood(self, coefficients: Modes, tail: Tail | None = None) -> Values:
        """Return log L."""
        return self.mixture.of_sums(*self.field.sums(coefficients, tail))

    @cached_property
    def parabola(self) -> NearParabola:
        """The mean over the components, as likely as they are at the best fit."""
        weights = self.mixture.weights_of_sums(self.field.gram, self.field.products)
        best = float(self.log_likelihood(self.field.at[None])[0])
        return NearParabola(self.field, weights, best + 0.5 * float(weights[0, 0]))


@dataclass(frozen=True, eq=False)
class OfOffsets:
    """Log-likelihood by a measure that nearly follows from the signed distances.

    Args:
        field: The residuals near the best fit.
        compared: Each observation with its measure and its noise.
        nodes: Number of nodes of the simulated interfaces, for each observation.
    """

    field: NearField
    compared: tuple[Compared, ...]
    nodes: tuple[int, ...]

    def log_likelihood(self, coefficients: Modes, tail: Tail | None = None) -> Values:
        """Return log L."""
        size = max(BLOCK // len(self.field.residuals), 1)
        parts = [slice(k, k + size) for k in range(0, len(coefficients), size)]
        return np.concatenate([self._block(coefficients[p], None if tail is None else tail[p]) for p in parts])

    @cached_property
    def parabola(self) -> NearParabola:
        """The same weights everywhere: those that square and derivative of d² have at the best fit."""
        r = self.field.residuals
        weights = np.concatenate([one.weights(r[part]) for one, part in self._parts()])
        factors = self.field.factors
        gram = factors.T @ (factors * weights[:, None])
        best = float(self.log_likelihood(self.field.at[None])[0])
        return NearParabola(self.field, gram, best + 0.5 * float(gram[0, 0]))

    def _block(self, coefficients: Modes, tail: Tail | None) -> Values:
        offsets = self.field.offsets(coefficients, tail)
        return np.asarray(sum(one.log_likelihood(offsets[:, part]) for one, part in self._parts()))

    def _parts(self) -> Iterator[tuple["_ByOffsets", slice]]:
        first = 0
        for one, nodes in zip(self.compared, self.nodes, strict=True):
            number = len(one.observation.interface.points)
            yield _ByOffsets(one, nodes), slice(first, first + number)
            first += number


@dataclass(frozen=True, eq=False)
class _ByOffsets:
    """log L of one observation by a measure of offsets.

    Args:
        compared: The observation with its measure and its noise.
        nodes: Number of nodes of the simulated interface.
    """

    compared: Compared
    nodes: int

    def log_likelihood(self, offsets: Float[np.ndarray, "draw seen"]) -> Values:
        return np.asarray(self.compared.noise.log_density(self._squares(offsets)))

    def weights(self, r: Float[np.ndarray, " seen"]) -> Float[np.ndarray, " seen"]:
        """Return w with log L ≈ constant - ½ Σ w r² near some offsets, whose typical size each of them has at least."""
        size = np.maximum(np.abs(r), max(float(np.sqrt(np.mean(r**2))), NOTHING))
        squares = np.concatenate([self._squares(_rows(size, k)) for k in range(0, len(r), ROWS)])
        d2 = float(self._squares(size[None])[0])
        density = self.compared.noise.log_density(np.array([d2, (1 + SMALL) * d2]))
        return np.asarray(2 * squares / size**2 * float(density[0] - density[1]) / (SMALL * d2))

    def _squares(self, offsets: Float[np.ndarray, "draw seen"]) -> Values:
        measure = self.compared.measure
        assert isinstance(measure, FollowsOffsets)
        squares = measure.of_offsets(offsets, self.compared.observation.interface, self.nodes)
        assert squares is not None
        return squares


def _rows(size: Float[np.ndarray, " seen"], first: int) -> Float[np.ndarray, "row seen"]:
    """Return rows of the diagonal matrix with these sizes, from the first one on."""
    number = min(ROWS, len(size) - first)
    rows = np.zeros((number, len(size)))
    rows[np.arange(number), first + np.arange(number)] = size[first : first + number]
    return rows


def nearby(
    surrogate: FieldSurrogate,
    observations: tuple[Observation, ...],
    measure: Discrepancy,
    shared: SharedErrors | None,
) -> Nearby | None:
    """Return the log-likelihood near the best fit; None for surfaces, and for measures that do not follow offsets."""
    if any(seen.interface.dim != 2 for seen in observations):
        return None
    errors = tuple(seen.noise for seen in observations if isinstance(seen.noise, PointErrors))
    if shared is not None or (isinstance(measure, NormalOffset) and len(errors) == len(observations)):
        joint = JointErrors(observations, errors) if shared is None else shared.joint
        field = linearise(surrogate, joint).field
        return OfStatedErrors(field, joint.model) if field.finite else None
    nodes = tuple(len(surrogate.layouts[seen.condition].template.points) for seen in observations)
    each = tuple(compared(seen, measure, number) for seen, number in zip(observations, nodes, strict=True))
    if not all(follows_offsets(one.measure, one.observation, number) for one, number in zip(each, nodes, strict=True)):
        return None
    equal = JointErrors(observations, tuple(PointErrors(1.0) for _ in observations))
    field = linearise(surrogate, equal).field
    return OfOffsets(field, each, nodes) if field.finite else None


def follows_offsets(measure: Discrepancy, observation: Observation, nodes: int) -> bool:
    """Return whether the measure nearly follows from the signed distances of the observed points."""
    if not isinstance(measure, FollowsOffsets):
        return False
    seen = observation.interface
    return measure.of_offsets(np.zeros((1, len(seen.points))), seen, nodes) is not None
