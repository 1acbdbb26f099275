"""Histograms of inputs, and quantiles of the interfaces that a posterior predicts."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.foundations import require
from strandline.interface import Interface

LEVELS = (0.05, 0.5, 0.95)
PerParticle = Float[np.ndarray, " particle"]


@dataclass(frozen=True, eq=False)
class Histogram:
    """Marginal of one input: the probability of each bin between edges in the unit of the input."""

    edges: Float[np.ndarray, " edge"]
    mass: Float[np.ndarray, " bin"]

    @property
    def density(self) -> Float[np.ndarray, " bin"]:
        """Probability density of each bin (bins,), in one over the unit of the input."""
        return np.asarray(self.mass / np.diff(self.edges))


def histogram(
    values: PerParticle, weights: PerParticle, *, bounds: tuple[float, float] | None = None, bins: int = 30
) -> Histogram:
    """Return the weighted histogram of one input between `bounds`, by default the range of `values`.

    Raises:
        InvalidInput: Draws outside the bounds.
    """
    limits = _limits(values, bounds)
    mass, edges = np.histogram(values, bins=bins, range=limits, weights=weights)
    return Histogram(edges, np.asarray(mass, float))


def histogram_mode(
    draws: Float[np.ndarray, "particle dim"],
    weights: PerParticle,
    *,
    bounds: Sequence[tuple[float, float]],
    bins: int = 30,
) -> Float[np.ndarray, " dim"]:
    """Return the centre of the bin with the highest probability (dim,); the first if several tie.

    This is the MAP estimate under uncertainty (paper, Remark 8): pass only the columns of the calibrated inputs, which
    integrates over the nuisance inputs. The study takes 30 bins per input in 2-D and 10 in 6-D.
    """
    limits = np.array([_limits(column, bound) for column, bound in zip(draws.T, bounds, strict=True)])
    low, width = limits[:, 0], (limits[:, 1] - limits[:, 0]) / bins
    cell = np.minimum(((draws - low) / width).astype(int), bins - 1)
    cells, member = np.unique(cell, axis=0, return_inverse=True)
    mass = np.bincount(member.ravel(), weights=weights, minlength=len(cells))
    return np.asarray(low + (cells[np.argmax(mass)] + 0.5) * width)


def _limits(values: PerParticle, bounds: tuple[float, float] | None) -> tuple[float, float]:
    low, high = (float(values.min()), float(values.max())) if bounds is None else bounds
    expected = f"bounds that contain all draws, {values.min():g} to {values.max():g}"
    remedy = "Widen the bounds: draws left out would be probability left out."
    inside = not (values.min() < low or values.max() > high)
    require(inside, "range of a histogram", [low, high], expected, remedy)
    return low, high


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
