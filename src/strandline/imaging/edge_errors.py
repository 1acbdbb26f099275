"""The errors of an edge, estimated from the picture in which it was found."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.imaging.located import Located

__all__ = ["EdgeErrors", "edge_errors", "offset_sd"]

LEAST_SD = 0.01
"""Smallest standard deviation of a point, px: no picture shows an edge more closely."""


@dataclass(frozen=True)
class EdgeErrors:
    """Errors of the points of an edge; lengths in the unit of the pixel size, pixels if it is (1, 1).

    Args:
        sd: Standard deviation s of a point along its normal.
        length: Integral correlation length ℓ = ∫₀^∞ ρ(t) dt of these errors along the edge.
        offset: Standard deviation of a common offset of all points along their normals; never 0.
        spacing: Distance of neighbouring points along the edge.
        blur: Standard deviation of the blur across the edge.
        radius: Smallest radius of curvature of the smoothed edge.
        contrast: Grey value outside of the solid minus that inside.
        contrast_to_noise: Size of the contrast over the noise: of one pixel for methods `erf` and `contour`, of the
            mean over a square of 10 × 10 px for `path`.
        limit_share: Share of the points at the limit of the strip.
        facts: What the method estimated besides, by name, e.g. κ for speckle.
    """

    sd: float
    length: float
    offset: float
    spacing: float
    blur: float
    radius: float
    contrast: float
    contrast_to_noise: float
    limit_share: float
    facts: dict[str, float]

    @property
    def level(self) -> float:
        """The product s²ℓ: half the spectral density of the errors at low frequencies, which is what counts."""
        return self.sd**2 * self.length


def edge_errors(
    located: Located, curvatures: Float[np.ndarray, " point"], *, bias: float, side: float, unit: float, kept: int
) -> EdgeErrors:
    """Return the errors of an edge.

    Args:
        located: The edge, lengths in px.
        curvatures: Curvatures 1/R at the points that are kept, 1/px.
        bias: Standard deviation of a common offset of a straight edge, in pixels.
        side: Size of a pixel along the normals, px.
        unit: Length of the px in the unit of the pixel size.
        kept: Number of points that are kept.
    """
    radius = 1 / max(float(np.abs(curvatures).max(initial=0.0)), 1e-9)
    return EdgeErrors(
        sd=unit * max(located.scatter.sd, LEAST_SD),
        length=unit * located.scatter.length,
        offset=unit * offset_sd(bias * side, located.blur, curvatures),
        spacing=unit * float(np.median(np.diff(located.course.arc))),
        blur=unit * located.blur,
        radius=unit * radius,
        contrast=located.contrast,
        contrast_to_noise=located.contrast_to_noise,
        limit_share=float(located.at_limit.sum()) / max(kept, 1),
        facts=located.facts,
    )


def offset_sd(straight: float, blur: float, curvatures: Float[np.ndarray, " point"]) -> float:
    """Return the standard deviation of a common offset: that of a straight edge, and w²/2R, by which blur moves a bend.

    R is the root mean square radius of the edge.
    """
    bend = math.sqrt(float(np.mean(curvatures**2))) if len(curvatures) else 0.0
    return math.hypot(straight, 0.5 * blur**2 * bend)
