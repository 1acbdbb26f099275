"""Contours of one state, compared with each other or with themselves smoothed, show the errors of their points."""

from strandline.discrepancy.contours.repeats import Repeats, errors_from_repeats
from strandline.discrepancy.contours.roughness import Roughness, errors_from_roughness

__all__ = ["Repeats", "Roughness", "errors_from_repeats", "errors_from_roughness"]
