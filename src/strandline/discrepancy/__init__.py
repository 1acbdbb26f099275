"""Discrepancies d² between a simulated and an observed interface, one measure per file.

In: interfaces of runs and one observed. Out: d² and, where the noise has a covariance, whitened distances.
"""

from strandline.discrepancy.closest_point import ClosestPoint, node_weights
from strandline.discrepancy.comparison import (
    apart,
    axes_mistake,
    count_of_distances,
    extent,
    extent_ratio,
    noise_units,
    oriented_like_runs,
    require_plausible,
    unit_mistake,
)
from strandline.discrepancy.contours import (
    Repeats,
    Roughness,
    errors_from_repeats,
    errors_from_roughness,
    path_of,
    smoothed,
)
from strandline.discrepancy.currents import Currents
from strandline.discrepancy.joint_errors import (
    JointErrors,
    Points,
    WhitenedOffset,
    places_of,
    residuals_of,
    shared_errors,
    sums_of,
)
from strandline.discrepancy.measurement_lines import LineReadings, MeasurementLines
from strandline.discrepancy.nearest import closest_points, squared_distances
from strandline.discrepancy.normal_offset import BEYOND, NormalOffset, Sums, extended, signed_distances
from strandline.discrepancy.protocol import (
    AdaptsToErrors,
    ComparesMany,
    CountsDistances,
    Discrepancy,
    FollowsOffsets,
    HasTerms,
    KnowsPointErrors,
    MeasureKey,
    Snapshot,
    Values,
    independent_terms,
    squared_discrepancies,
    unit_of,
)
from strandline.discrepancy.tracked_points import TrackedPoints

__all__ = [
    "DISCREPANCIES",
    "AdaptsToErrors",
    "ClosestPoint",
    "ComparesMany",
    "CountsDistances",
    "Currents",
    "Discrepancy",
    "FollowsOffsets",
    "HasTerms",
    "KnowsPointErrors",
    "LineReadings",
    "MeasurementLines",
    "NormalOffset",
    "Repeats",
    "Roughness",
    "TrackedPoints",
    "WhitenedOffset",
    "apart",
    "axes_mistake",
    "count_of_distances",
    "errors_from_repeats",
    "errors_from_roughness",
    "extent",
    "extent_ratio",
    "independent_terms",
    "noise_units",
    "oriented_like_runs",
    "require_plausible",
    "signed_distances",
    "squared_discrepancies",
    "unit_mistake",
    "unit_of",
]

DISCREPANCIES = {
    "measurement_lines": MeasurementLines,
    "tracked_points": TrackedPoints,
    "closest_point": ClosestPoint,
    "currents": Currents,
    "normal_offset": NormalOffset,
}
"""Names in study files → measures; their options are the fields of the class."""
