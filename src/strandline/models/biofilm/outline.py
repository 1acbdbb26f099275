"""The outline of a biofilm: from a few control points to the polygon that the mesh follows."""

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from strandline.interface import Interface

__all__ = ["CONTROL_POINTS", "NODES", "outline"]

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


def outline(control_points: tuple[tuple[float, float], ...] = CONTROL_POINTS, *, nodes: int = NODES) -> Interface:
    """Return the undeformed interface, mm: `nodes` points at equal arclength on a spline through `control_points`.

    The cubic spline is parametrised by chord length. The first and last point lie on the channel's floor (y = 0).
    """
    points = np.array(control_points, float)
    curve = CubicSpline(_chord_length(points), points, axis=0)
    fine = curve(np.linspace(0.0, curve.x[-1], 4001))
    result = Interface.polyline(fine).resampled(nodes).points
    result[[0, -1]] = points[[0, -1]]
    return Interface.polyline(result)


def _chord_length(points: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, " point"]:
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])
