"""The interfaces that a posterior predicts: pointwise quantiles, and offsets along the normals of their median."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.interface import Interface

__all__ = ["InterfaceBand", "Offsets", "interface_band", "normal_offsets", "observed_offsets"]

LEVELS = (0.05, 0.5, 0.95)


@dataclass(frozen=True, eq=False)
class InterfaceBand:
    """Quantiles at 5, 50 and 95 %, node by node and coordinate by coordinate, mm."""

    low: Float[np.ndarray, "point xyz"]
    median: Float[np.ndarray, "point xyz"]
    high: Float[np.ndarray, "point xyz"]


@dataclass(frozen=True, eq=False)
class Offsets:
    """Signed distances from a polyline, mm, positive to the left of its direction, at positions along it, mm."""

    arc_length: Float[np.ndarray, " point"]
    offset: Float[np.ndarray, "*draw point"]


def interface_band(points: Float[np.ndarray, "draw point xyz"]) -> InterfaceBand:
    """Return the pointwise quantiles of interfaces that have the same nodes."""
    return InterfaceBand(*np.quantile(points, LEVELS, axis=0))


def normal_offsets(points: Float[np.ndarray, "draw point 2"], centre: Interface) -> Offsets:
    """Return how far each node lies from the same node of `centre`, along the normal there; one row per draw."""
    normals = np.zeros_like(centre.points)
    for corner in centre.cells.T:
        np.add.at(normals, corner, centre.normals)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    arc_length = np.zeros(len(centre.points))
    arc_length[centre.cells[:, 0]] = _starts(centre)
    if not centre.closed:
        arc_length[centre.cells[-1, 1]] = centre.lengths.sum()
    return Offsets(arc_length, np.sum((points - centre.points) * normals, axis=2))


def observed_offsets(observed: Interface, centre: Interface) -> Offsets:
    """Return the distance of each point of `observed` from the closest point of the polyline `centre`."""
    tangent = centre.ends - centre.starts
    apart = observed.points[:, None] - centre.starts
    share = np.clip(np.sum(apart * tangent, axis=2) / centre.lengths**2, 0.0, 1.0)
    distance = np.linalg.norm(apart - share[..., None] * tangent, axis=2)
    rows, nearest = np.arange(len(distance)), np.argmin(distance, axis=1)
    side = np.sum(apart * centre.normals, axis=2)[rows, nearest]
    arc_length = (_starts(centre) + share * centre.lengths)[rows, nearest]
    order = np.argsort(arc_length, kind="stable")
    return Offsets(arc_length[order], (np.copysign(distance[rows, nearest], side))[order])


def _starts(polyline: Interface) -> Float[np.ndarray, " cell"]:
    """Return the arc length at which each segment starts."""
    return np.asarray(np.cumsum(polyline.lengths) - polyline.lengths)
