"""Log-likelihoods of fields near the one that fits best, from residuals that are polynomials of the field.

They take a hundredth of the time of comparing interfaces, and lead a sampler near the posterior. What they miss is
weighed off against the measure itself.
"""

from dataclasses import dataclass
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
from strandline.likelihood.shared_errors import SharedErrors
from strandline.surrogate.field import FieldPrediction, FieldSurrogate

__all__ = ["Nearby", "Numbers", "OfMixture", "OfOffsets", "OfStatedErrors", "drawn_fields", "follows_offsets", "nearby"]

Values = Float[np.ndarray, " point"]
Modes = Float[np.ndarray, "point mode"]
Tail = Float[np.ndarray, "point rest"]
Numbers = tuple[Float[np.ndarray, "draw mode"], Float[np.ndarray, "draw rest"]]
"""Standard normal numbers that fields are drawn with: of the modes, and of what they leave over."""
BLOCK = 1 << 22
"""Residuals computed together."""


@runtime_checkable
class Nearby(Protocol):
    """A log-likelihood of fields near the one that fits best."""

    def log_likelihood(self, coefficients: Modes, tail: Tail | None = None) -> Values:
        """Return log L of the interfaces with these coefficients of the modes, mm, and of what they leave over."""
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

    def _block(self, coefficients: Modes, tail: Tail | None) -> Values:
        offsets, total, first = self.field.offsets(coefficients, tail), np.zeros(len(coefficients)), 0
        for one, nodes in zip(self.compared, self.nodes, strict=True):
            seen = one.observation.interface
            own = offsets[:, first : first + len(seen.points)]
            assert isinstance(one.measure, FollowsOffsets)
            squares = one.measure.of_offsets(own, seen, nodes)
            assert squares is not None
            total += one.noise.log_density(squares)
            first += len(seen.points)
        return total


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


def drawn_fields(found: FieldPrediction, numbers: Numbers) -> tuple[Modes, Tail]:
    """Return the fields drawn at each point with the same numbers, one point after the other."""
    of_modes, of_tail = numbers
    drawn = found.mean[:, None] + np.sqrt(found.variance)[:, None] * of_modes
    return drawn.reshape(-1, drawn.shape[2]), np.tile(of_tail, (len(found.mean), 1))


def follows_offsets(measure: Discrepancy, observation: Observation, nodes: int) -> bool:
    """Return whether the measure nearly follows from the signed distances of the observed points."""
    if not isinstance(measure, FollowsOffsets):
        return False
    seen = observation.interface
    return measure.of_offsets(np.zeros((1, len(seen.points))), seen, nodes) is not None
