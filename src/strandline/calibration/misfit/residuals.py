"""The residuals of all observed points together: signed distances to predicted interfaces, and their covariance."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from strandline.discrepancy import Discrepancy
from strandline.interface import ErrorModel, Interface, Observation
from strandline.likelihood.joint_errors import JointErrors, Points
from strandline.likelihood.residual_noise import StatedErrors, stated_errors
from strandline.likelihood.residuals import residuals_of
from strandline.likelihood.shared_errors import shared_errors

__all__ = ["Residuals"]


@dataclass(frozen=True, eq=False)
class Residuals:
    """Signed distances of all observed points, one observation after the other, mm.

    Args:
        observations: The observations.
        measure: The measure d² behind the posterior.
        stated: Errors of the points of each observation.
        joint: The same errors, with what the observations share.
        model: Covariance C = D + BBᵀ of all residuals.
    """

    observations: tuple[Observation, ...]
    measure: Discrepancy
    stated: tuple[StatedErrors, ...]
    joint: JointErrors
    model: ErrorModel

    @classmethod
    def of(
        cls,
        observations: Sequence[Observation],
        measure: Discrepancy,
        templates: Mapping[str, Interface],
        explained: Float[np.ndarray, "seen cause"] | None = None,
    ) -> "Residuals":
        """Return the residuals of observations; global errors are shared where the likelihood shares them.

        Args:
            observations: The observations.
            measure: The measure d² behind the posterior.
            templates: A predicted interface of each condition, for its number of nodes.
            explained: What errors of the model that were allowed for do to the residuals, mm; None if there are none.

        Raises:
            InvalidInput: A noise variance that no errors of points have.
        """
        stated = [stated_errors(seen, measure, len(templates[seen.condition].points)) for seen in observations]
        shared = shared_errors(observations, measure)
        if shared is not None:
            return cls(tuple(observations), measure, tuple(stated), shared.joint, shared.model)
        joint = JointErrors(tuple(observations), tuple(one.errors for one in stated))
        model = joint.model
        if explained is not None:
            model = ErrorModel(model.local, np.hstack([model.shared, explained]))
        return cls(tuple(observations), measure, tuple(stated), joint, model)

    @cached_property
    def parts(self) -> tuple[slice, ...]:
        """Places of the residuals of each observation."""
        ends = np.cumsum([len(seen.interface.points) for seen in self.observations]).tolist()
        return tuple(slice(begin, end) for begin, end in zip([0, *ends[:-1]], ends, strict=True))

    def at(self, points: Points, templates: Mapping[str, Interface]) -> Float[np.ndarray, "row seen"]:
        """Return the residuals of predicted interfaces with these points, one row each."""
        return residuals_of(self.joint, points, templates)

    def drawn(self, number: int, random: np.random.Generator) -> Float[np.ndarray, "draw seen"]:
        """Return residuals that the errors of the points alone cause, as the observations state them."""
        local = [
            one.errors.local_draws(seen.interface, number, random)
            for one, seen in zip(self.stated, self.observations, strict=True)
        ]
        common = random.standard_normal((number, self.model.shared.shape[1])) @ self.model.shared.T
        return np.asarray(np.concatenate(local, axis=1) + common)
