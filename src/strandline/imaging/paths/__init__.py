"""Typed paths, and paths that other programs exported: Fiji (.roi, XY coordinates), napari (Shapes as .csv).

OpenDrop finds its drop without a path, so that there is nothing of it to read.
"""

from strandline.imaging.paths.first_path import FirstPath, typed_path
from strandline.imaging.paths.read import PATHS, read_path

__all__ = ["PATHS", "FirstPath", "read_path", "typed_path"]
