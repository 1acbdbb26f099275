"""Files that simulators and measurements write → interfaces.

In: a file and, where the file leaves a choice, options. Out: an `Interface`, or the line that is wrong and the way out.
"""

from typing import TYPE_CHECKING

from strandline.foundations.doors import door

if TYPE_CHECKING:
    from strandline.readers.cells import require_in_order
    from strandline.readers.contents import Block, Contents, Unreadable, refused, undamaged
    from strandline.readers.options import READERS, TO_MM, Reading
    from strandline.readers.read import Reader, read_interface, read_point_sds
    from strandline.readers.shape import repeats_first, require_clear_ends
    from strandline.readers.tables import outlines
else:
    __getattr__ = door(__name__, __file__)

__all__ = ["READERS", "Block", "Contents", "Reader", "Reading", "Unreadable", "read_interface", "read_point_sds"]
