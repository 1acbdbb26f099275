"""The outline of a biofilm: from a few control points to the polygon that the mesh follows."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from strandline.errors import InvalidInput
from strandline.interface import Interface
from strandline.models.biofilm.channel import ON_WALL

__all__ = ["CONTROL_POINTS", "NODES", "Outline", "bodies"]

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
LEAST = 4
"""Fewest nodes of a body."""


@dataclass(frozen=True)
class Outline:
    """The undeformed interface.

    Points on the floor between the first and the last one, two at a time, are the end of one body and the start of the
    next: several bodies stand on the floor, and the interface follows the floor between them.

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
        for body in bodies(np.array(self.points, float)):
            if body.stop - body.start < 3:
                x, y = self.points[body.start]
                _refuse(
                    "body of the outline", f"{body.stop - body.start} point(s) from ({x:g}, {y:g}) mm on",
                    "at least three points, with two neighbouring points on the floor between bodies",
                    "Correct the points.",
                )  # fmt: skip
        if self.nodes is None and self.spline:
            _refuse("nodes of the outline", self.nodes, "a number of nodes for a spline", "Give nodes, e.g. 66.")
        if self.nodes is not None and self.nodes < LEAST:
            _refuse("nodes of the outline", self.nodes, "at least 4", "Raise the number of nodes.")

    @classmethod
    def of(cls, interface: Interface, *, nodes: int | None = NODES) -> "Outline":
        """Return the outline that follows an interface, e.g. one that was read from a file or an image."""
        return cls(tuple((float(x), float(y)) for x, y in interface.points), spline=False, nodes=nodes)

    def interface(self) -> Interface:
        """Return the undeformed interface, mm."""
        points = np.array(self.points, float)
        parts = [points[body] for body in bodies(points)]
        curves = [self._curve(part) for part in parts]
        if self.nodes is None:
            return Interface.polyline(np.concatenate([curve.points for curve in curves]))
        lengths = np.array([curve.lengths.sum() for curve in curves])
        counts = np.maximum(LEAST, np.rint(self.nodes * lengths / lengths.sum()).astype(int))
        pieces = [curve.resampled(int(count)).points for curve, count in zip(curves, counts, strict=True)]
        for piece, part in zip(pieces, parts, strict=True):
            piece[[0, -1]] = part[[0, -1]]
        return Interface.polyline(np.concatenate(pieces))

    def _curve(self, points: Float[np.ndarray, "point 2"]) -> Interface:
        """Return the outline of one body."""
        if not self.spline or len(points) < 3:
            return Interface.polyline(points)
        spline = CubicSpline(_chord_length(points), points, axis=0)
        return Interface.polyline(spline(np.linspace(0.0, spline.x[-1], 4001)))


def bodies(points: Float[np.ndarray, "point 2"]) -> list[slice]:
    """Return which points belong to each body: a pair of points on the floor separates two of them."""
    on_floor = np.abs(points[:, 1]) < ON_WALL
    starts = np.flatnonzero(on_floor[1:-2] & on_floor[2:-1]) + 2
    edges = [0, *starts.tolist(), len(points)]
    return [slice(a, b) for a, b in pairwise(edges)]


def _chord_length(points: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, " point"]:
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _refuse(what: str, value: object, expected: str, remedy: str) -> None:
    raise InvalidInput(what, value=value, expected=expected, remedy=remedy)
