"""Stacks of pictures → the surface of the solid in them, with its errors."""

from strandline.imaging.surfaces.surface import Region, StackFrame, StatedRegion, Surface, find_surface
from strandline.imaging.surfaces.surface_errors import SurfaceErrors

__all__ = ["Region", "StackFrame", "StatedRegion", "Surface", "SurfaceErrors", "find_surface"]
