"""Stacks of pictures → the surface of the solid in them, with its errors."""

from strandline.imaging.surfaces.placed import StackFrame
from strandline.imaging.surfaces.regions import Region, region_of
from strandline.imaging.surfaces.surface import Surface, find_surface
from strandline.imaging.surfaces.surface_errors import SurfaceErrors

__all__ = ["Region", "StackFrame", "Surface", "SurfaceErrors", "find_surface", "region_of"]
