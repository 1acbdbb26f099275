"""Files that simulators and measurements write → interfaces."""

from strandline.readers.options import Reading
from strandline.readers.problems import Unreadable
from strandline.readers.read import READERS, read_interface

__all__ = ["READERS", "Reading", "Unreadable", "read_interface"]
