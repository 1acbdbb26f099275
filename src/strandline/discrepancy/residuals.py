"""The distance between two interfaces, in units of the noise and in mm, for any measure."""

import math

import numpy as np

from strandline.discrepancy.protocol import CountsDistances, Discrepancy, independent_terms
from strandline.discrepancy.search.nearest import squared_distances
from strandline.interface import Interface

__all__ = ["apart", "count_of_distances", "noise_units"]


def count_of_distances(measure: Discrepancy, simulated: Interface, observed: Interface) -> float | None:
    """Return how many distances d² sums, so that √(d²/count) is their root mean square.

    If the measure does not count its distances, its independent terms count. None if d² is not a sum of squared
    distances: then σ_N is not a distance either.
    """
    if isinstance(measure, CountsDistances):
        return float(measure.distances(simulated, observed))
    count = independent_terms(measure, observed)
    return None if count is None else float(count)


def noise_units(square: float, variance: float, count: float | None) -> float:
    """Return a residual in units of σ_N: the root mean square of its distances, or √d² if it is not a sum.

    Args:
        square: d², in the measure's unit.
        variance: σ_N², in the same unit.
        count: The number of distances, from `count_of_distances`.
    """
    return math.sqrt(square / (variance * (count or 1.0)))


def apart(one: Interface, other: Interface) -> tuple[float, float]:
    """Return the distance between two interfaces, mm: root mean square and largest.

    It is measured from the nodes of each to the closest points of the other; the larger of the two directions counts.
    """
    squares = [squared_distances(a.points, b) for a, b in ((one, other), (other, one))]
    return math.sqrt(max(float(s.mean()) for s in squares)), math.sqrt(max(float(np.max(s)) for s in squares))
