"""Files that simulators and measurements write → interfaces."""

from strandline.readers.contents import Block, Contents, Unreadable
from strandline.readers.options import Reading
from strandline.readers.read import READERS, Reader, read_interface, read_point_sds

__all__ = ["READERS", "Block", "Contents", "Reader", "Reading", "Unreadable", "read_interface", "read_point_sds"]
