"""Interfaces: polylines and triangulated surfaces, with a direction, and observations of them.

In: arrays of points and elements, mm. Out: an `Interface`, or an `Observation` with the errors of its points. It knows
neither files nor models.
"""

from strandline.interface.interface import Interface, Oriented, inside_polygon, oriented_like
from strandline.interface.noise import NOISES, GaussianNoise, Noise, Observation, UnknownErrors, is_condition
from strandline.interface.normals import (
    arc_lengths,
    as_complex,
    node_normals,
    normals_at,
    point_normals,
    spacings,
    steady_lengths,
    steady_normals,
)
from strandline.interface.point_errors import GLOBAL, MOST, ErrorModel, PointErrors, summed_length
from strandline.interface.triangles import shortest_altitudes, signed_volume, triangle_sides, vector_areas

__all__ = [
    "GLOBAL",
    "NOISES",
    "ErrorModel",
    "GaussianNoise",
    "Interface",
    "Noise",
    "Observation",
    "Oriented",
    "PointErrors",
    "UnknownErrors",
    "arc_lengths",
    "as_complex",
    "is_condition",
    "normals_at",
    "oriented_like",
    "point_normals",
    "spacings",
    "steady_lengths",
    "steady_normals",
    "summed_length",
]
