"""The outline of a biofilm: from a few control points to the polygon that the mesh follows."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from strandline.errors import InvalidInput
from strandline.interface import Interface

__all__ = ["CONTROL_POINTS", "NODES", "Outline"]

CONTROL_POINTS = (
    (0.540, 0.000),
    (0.582, 0.085),
    (0.582, 0.190),
    (0.598, 0.304),
    (0.672, 0.408),
    (0.803, 0.465),
    (0.950, 0.465),
    (1.092, 0.428),
    (1.202, 0.347),
    (1.244, 0.238),
    (1.254, 0.133),
    (1.302, 0.052),
    (1.391, 0.000),
)
"""Points (x, y) in mm from the upstream to the downstream foot; the outline of the study is not published in text."""

NODES = 66
"""Interface nodes of the study (its n_in)."""


@dataclass(frozen=True)
class Outline:
    """The undeformed interface.

    Args:
        points: Points (x, y) from left to right, mm; the first and last lie on the floor or on the channel's ends.
        spline: whether `points` are control points of a cubic spline (parametrised by chord length) or the outline.
        nodes: number of interface nodes, equally spaced by arclength; None keeps `points` as they are.

    Raises:
        InvalidInput: too few points or nodes, points that are not pairs of numbers, or nodes None with a spline.
    """

    points: tuple[tuple[float, float], ...] = CONTROL_POINTS
    spline: bool = True
    nodes: int | None = NODES

    def __post_init__(self) -> None:
        shape = np.shape(np.array(self.points, dtype=object))
        if len(shape) != 2 or shape[1] != 2 or shape[0] < 3:
            _refuse("points of the outline", self.points, "at least three pairs (x, y) in mm", "Correct the points.")
        if self.nodes is None and self.spline:
            _refuse("nodes of the outline", self.nodes, "a number of nodes for a spline", "Give nodes, e.g. 66.")
        if self.nodes is not None and self.nodes < 4:
            _refuse("nodes of the outline", self.nodes, "at least 4", "Raise the number of nodes.")

    @classmethod
    def of(cls, interface: Interface, *, nodes: int | None = NODES) -> "Outline":
        """Return the outline that follows an interface, e.g. one that was read from a file or an image."""
        return cls(tuple((float(x), float(y)) for x, y in interface.points), spline=False, nodes=nodes)

    def interface(self) -> Interface:
        """Return the undeformed interface, mm."""
        points = np.array(self.points, float)
        curve = Interface.polyline(points)
        if self.spline:
            spline = CubicSpline(_chord_length(points), points, axis=0)
            curve = Interface.polyline(spline(np.linspace(0.0, spline.x[-1], 4001)))
        if self.nodes is None:
            return curve
        result = curve.resampled(self.nodes).points
        result[[0, -1]] = points[[0, -1]]
        return Interface.polyline(result)


def _chord_length(points: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, " point"]:
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _refuse(what: str, value: object, expected: str, remedy: str) -> None:
    raise InvalidInput(what, value=value, expected=expected, remedy=remedy)
