"""Pictures → the interface in them, with its errors.

In: files of pictures or stacks, pixel sizes, places to begin. Out: points in mm with standard deviations and a length
of correlation, which `studies` turns into an `Observation`.
"""

from typing import TYPE_CHECKING

from strandline.foundations.doors import door

if TYPE_CHECKING:
    from strandline.imaging.clicks import Clicks, ScaleBar, as_json, read_clicks
    from strandline.imaging.edges.edge import Edge, find_edge
    from strandline.imaging.edges.edge_checks import EdgeErrors
    from strandline.imaging.edges.edge_methods import EDGES, edge_method
    from strandline.imaging.edges.markov_path import MarkovPath
    from strandline.imaging.edges.strip import EdgeMethod, Located, Scatter, strip_along
    from strandline.imaging.frame import Frame, Registration, registered
    from strandline.imaging.frame_errors import FrameErrors, errors_from_frames
    from strandline.imaging.outline import Outlined, outline_of
    from strandline.imaging.paths import is_of_clicks, read_path, typed_path
    from strandline.imaging.picture import SAME, Picture, PictureFile, PictureReading, PixelSize, Stack, StatedSize
    from strandline.imaging.read import read_frames, read_picture, read_stack
    from strandline.imaging.surfaces.mesh import Mesh, cut
    from strandline.imaging.surfaces.surface import StackFrame, StatedRegion, Surface, find_surface
else:
    __getattr__ = door(__name__, __file__)

__all__ = [
    "EDGES",
    "Clicks",
    "Edge",
    "EdgeErrors",
    "EdgeMethod",
    "Frame",
    "FrameErrors",
    "Located",
    "Outlined",
    "Picture",
    "PictureFile",
    "PictureReading",
    "PixelSize",
    "Registration",
    "ScaleBar",
    "Scatter",
    "Stack",
    "edge_method",
    "errors_from_frames",
    "find_edge",
    "is_of_clicks",
    "outline_of",
    "read_clicks",
    "read_frames",
    "read_path",
    "read_picture",
    "read_stack",
    "registered",
    "strip_along",
    "typed_path",
]
