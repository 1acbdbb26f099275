"""Pictures → the interface in them, with its errors."""

from strandline.imaging.clicks import Clicks, ScaleBar
from strandline.imaging.clicks_file import read_clicks, write_clicks
from strandline.imaging.edge import EDGES, Edge, find_edge
from strandline.imaging.edge_errors import EdgeErrors
from strandline.imaging.frame import Frame
from strandline.imaging.frame_errors import FrameErrors, errors_from_frames
from strandline.imaging.outline import Outlined, outline_of
from strandline.imaging.paths.first_path import typed_path
from strandline.imaging.paths.read import read_path
from strandline.imaging.picture import Picture, Stack
from strandline.imaging.read import read_frames, read_picture, read_stack
from strandline.imaging.reading import PictureReading
from strandline.imaging.registration import Registration, registered

__all__ = [
    "EDGES",
    "Clicks",
    "Edge",
    "EdgeErrors",
    "Frame",
    "FrameErrors",
    "Outlined",
    "Picture",
    "PictureReading",
    "Registration",
    "ScaleBar",
    "Stack",
    "errors_from_frames",
    "find_edge",
    "outline_of",
    "read_clicks",
    "read_frames",
    "read_path",
    "read_picture",
    "read_stack",
    "registered",
    "typed_path",
    "write_clicks",
]
