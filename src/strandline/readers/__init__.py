"""Files that simulators and measurements write → interfaces."""

from strandline.readers.contents import Block, Contents, Unreadable
from strandline.readers.options import READERS, Reading
from strandline.readers.read import Reader, read_interface, read_point_sds

__all__ = ["READERS", "Block", "Contents", "Reader", "Reading", "Unreadable", "read_interface", "read_point_sds"]
