"""Several observations whose position, rotation and scale are wrong together, as pictures of a fixed camera are."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.discrepancy import Discrepancy, NormalOffset
from strandline.discrepancy.protocol import require_same_direction
from strandline.interface import ErrorModel, Interface, Observation, PointErrors
from strandline.likelihood.joint_errors import JointErrors, Points
from strandline.likelihood.residuals import sums_of

__all__ = ["SharedErrors", "shared_errors"]


@dataclass(frozen=True, eq=False)
class SharedErrors:
    """d² = rᵀ C⁻¹ r of the signed distances r of all observed points together.

    Args:
        joint: Errors of the observations.
    """

    joint: JointErrors

    @property
    def model(self) -> ErrorModel:
        """Covariance C of the residuals, in the order of the observations."""
        return self.joint.model

    def square(self, interfaces: Mapping[str, Interface]) -> float:
        """Return d² of simulated interfaces by condition.

        Raises:
            InvalidInterface: One runs against its observation.
        """
        for seen in self.joint.observations:
            require_same_direction(interfaces[seen.condition], seen.interface)
        points = {seen.condition: interfaces[seen.condition].points[None] for seen in self.joint.observations}
        return float(self.many(points, interfaces)[0])

    def many(self, points: Points, templates: Mapping[str, Interface]) -> Float[np.ndarray, " run"]:
        """Return d² of each run, given its points by condition."""
        return self.model.square_of(*sums_of(self.joint, points, templates))


def shared_errors(observations: Sequence[Observation], measure: Discrepancy) -> SharedErrors | None:
    """Return the joint measure of several observations with shared errors; None if they are compared one by one."""
    errors = [o.noise for o in observations]
    if len(errors) < 2 or not isinstance(measure, NormalOffset):
        return None
    known = [one for one in errors if isinstance(one, PointErrors) and one.shared]
    if len(known) < len(errors) or len({(one.shift, one.rotation, one.scale) for one in known}) > 1:
        return None
    return SharedErrors(JointErrors(tuple(observations), tuple(known), common=True))
