"""Typed paths, and paths that other programs exported: Fiji (.roi, XY coordinates), napari (Shapes as .csv).

OpenDrop needs no path, but the profile of the drop that it saves, `fit.csv`, serves as one.
"""

from strandline.imaging.paths.first_path import FirstPath, typed_path
from strandline.imaging.paths.read import PATHS, is_of_clicks, read_path

__all__ = ["PATHS", "FirstPath", "is_of_clicks", "read_path", "typed_path"]
