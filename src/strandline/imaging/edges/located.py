"""What a method of finding an edge returns, and the protocol that methods follow."""

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from strandline.imaging.edges.strip import GreyValues, PerNormal, SmoothPath, Strip


@dataclass(frozen=True)
class Scatter:
    """Random errors of the points along an edge, in units of the smaller side of a pixel.

    Args:
        sd: Standard deviation s of a point along its normal.
        length: Integral correlation length ℓ = ∫₀^∞ ρ(t) dt along the edge.
    """

    sd: float
    length: float


NO_SCATTER = Scatter(math.nan, math.nan)
"""Errors before the last pass."""


@dataclass(frozen=True, eq=False)
class Located:
    """An edge along the normals of a course; lengths in units of the smaller side of a pixel.

    Args:
        strip: The samples on which it was found.
        offsets: Distance of the edge from the course along each normal, shape (normal,).
        sds: Standard deviation of each, shape (normal,).
        found: Normals on which the edge could be found.
        at_limit: Normals on which it lies at the limit of the strip.
        scatter: Random errors of the points, from this picture.
        blur: Standard deviation of the blur across the edge.
        contrast: Grey value on the left of the path minus that on its right.
        contrast_to_noise: Size of the contrast over the standard deviation of the noise; see the method.
        facts: What else the method estimated, by name.
    """

    strip: Strip
    offsets: PerNormal
    sds: PerNormal
    found: Bool[np.ndarray, " normal"]
    at_limit: Bool[np.ndarray, " normal"]
    scatter: Scatter
    blur: float
    contrast: float
    contrast_to_noise: float
    facts: dict[str, float]

    @property
    def course(self) -> SmoothPath:
        """The path along whose normals the edge was found."""
        return self.strip.course

    @property
    def points(self) -> Float[np.ndarray, "normal 2"]:
        """The points of the edge, neither smoothed nor selected."""
        return self.course.at(self.offsets)


@runtime_checkable
class EdgeMethod(Protocol):
    """A way to find an edge near a path."""

    @property
    def bias(self) -> float:
        """Standard deviation of a common offset of the edge, in pixels, where the edge is straight; above 0."""
        ...

    @property
    def passes(self) -> int:
        """Number of times the edge is looked for: from the second time on, near the edge found before."""
        ...

    def locate(self, picture: GreyValues, course: SmoothPath, counted: Bool[np.ndarray, " normal"] | None) -> Located:
        """Return the edge near a course.

        Args:
            picture: The picture.
            course: The path, in units of the smaller side of a pixel, with the solid on its right.
            counted: Normals whose points are kept, from which errors are estimated; None before the last pass, when
                no errors are needed.
        """
        ...
