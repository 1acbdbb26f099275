"""What a comparison of the observations with the best prediction finds."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from strandline.likelihood.residual_noise import ResidualNoise, StatedErrors

__all__ = ["ConditionMisfit", "Misfit", "Region"]


@dataclass(frozen=True)
class Region:
    """A part of the arc of an observed interface, or a patch of a surface.

    Args:
        begin: Arc length of the observed interface at which it begins, mm; 0 for a patch.
        end: Arc length at which it ends, mm; 0 for a patch.
        mean: Mean residual, mm, positive on the side of the normals.
        rms: Root mean square of the residuals, mm.
        side: Where the observed interface lies if the mean has one sign: ``above``, ``to the left of`` and the like;
            on a surface ``outside`` or ``inside``, outside being the side of the normals.
        excess: Mean over the standard deviation of such a mean of the noise; if the root mean square is more than twice
            the mean, its ratio to that of the noise instead.
        p_value: Probability of such residuals of a right model in any part, corrected for the number of parts.
        centre: Mean point of a patch, mm; None for a part of an arc.
    """

    begin: float
    end: float
    mean: float
    rms: float
    side: str
    excess: float
    p_value: float
    centre: tuple[float, float, float] | None = None


@dataclass(frozen=True, eq=False)
class ConditionMisfit:
    """The residuals of one observed interface: its distance from the best prediction, without global errors.

    Args:
        condition: The observed condition.
        arc_length: Arc length at each observed point, mm; its number on a surface.
        residual: Signed distance of each point, mm.
        stated: Errors of the points that the observation states.
        expected: Standard deviation and correlation length of residuals with these errors, mm.
        found: Those of the residuals, mm; on a surface the correlation length is that over distances in space.
        p_value: Probability that a right model leaves residuals as large.
        predictive_p: Posterior-predictive p-value of d².
        regions: Parts of the arc, or patches of the surface.
        removed: Most probable global errors of the observation, which the residuals do not contain: shift and offset,
            mm, rotation, degrees, and scale, a share; none if none are stated.
        surface: Whether a surface was observed.
    """

    condition: str
    arc_length: Float[np.ndarray, " point"]
    residual: Float[np.ndarray, " point"]
    stated: StatedErrors
    expected: ResidualNoise
    found: ResidualNoise
    p_value: float
    predictive_p: float
    regions: tuple[Region, ...] = ()
    removed: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    surface: bool = False

    @property
    def strained(self) -> tuple[str, float, float]:
        """The global error that is largest for what is stated: its name, size and stated standard deviation.

        In mm, degrees, or as a share. ("", 0, 1) if none is stated.
        """
        stated = {name: float(getattr(self.stated.errors, name)) for name in self.removed}
        found = [(name, math.hypot(*sizes), stated[name]) for name, sizes in self.removed.items() if stated[name] > 0]
        return max(found, key=lambda one: one[1] / one[2], default=("", 0.0, 1.0))

    @property
    def rms(self) -> float:
        """Root mean square of the residuals, mm."""
        return float(np.sqrt(np.mean(self.residual**2)))

    @property
    def ratio(self) -> float:
        """Ratio of s²ℓ of the residuals to that of the stated errors; of s²ℓ² on a surface."""
        longer = self.found.length / self.expected.length
        return self.found.level / self.expected.level * (longer if self.surface else 1.0)


@dataclass(frozen=True, eq=False, repr=False)
class Misfit:
    """Whether the model explains the observations within the noise.

    Args:
        verdict: The answer in one sentence.
        flagged: Whether it does not.
        p_value: Probability that a right model leaves residuals as large as those of the best fit; None if it could
            not be computed. Under a right model all its values are equally likely.
        predictive_p: Posterior-predictive p-value of d², conservative; None likewise.
        smooth_p: Probability that a right model leaves slow waves along the arc as large; None on surfaces.
        conditions: Residuals of each observation.
        notes: How it was computed, in sentences.
    """

    verdict: str
    flagged: bool
    p_value: float | None = None
    predictive_p: float | None = None
    smooth_p: float | None = None
    conditions: tuple[ConditionMisfit, ...] = ()
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<Misfit {self.verdict}>"

    @property
    def region_p(self) -> float | None:
        """Smallest p-value of a part of an arc; None if there are no parts."""
        return min((region.p_value for one in self.conditions for region in one.regions), default=None)
