"""Stacks of pictures → the surface of the solid in them, with its errors."""

from strandline.imaging.surfaces.profiles import SurfaceErrors
from strandline.imaging.surfaces.surface import Region, StackFrame, StatedRegion, Surface, find_surface

__all__ = ["Region", "StackFrame", "StatedRegion", "Surface", "SurfaceErrors", "find_surface"]
