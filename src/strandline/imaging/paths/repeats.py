"""Points that other programs repeat."""

import numpy as np
from jaxtyping import Float

from strandline.imaging.paths.first_path import FirstPath

__all__ = ["without_repeats"]


def without_repeats(points: Float[np.ndarray, "point 2"], *, closed: bool = False) -> FirstPath:
    """Return the path through `points` without those that repeat the one before them.

    A path that ends at its first point is closed.

    Args:
        points: Pixel coordinates (x, y), in order.
        closed: Whether the path is closed even if it does not end at its first point.

    Raises:
        InvalidInput: Points that make no path.
    """
    new = np.ones(len(points), dtype=bool)
    new[1:] = (points[1:] != points[:-1]).any(axis=1)
    kept = points[new]
    if len(kept) > 2 and (kept[0] == kept[-1]).all():
        kept, closed = kept[:-1], True
    return FirstPath(np.ascontiguousarray(kept), closed)
