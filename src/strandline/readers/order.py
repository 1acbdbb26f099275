"""Points of a table that are in no order along an outline, or leave open whether it is closed."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from strandline.readers.problems import refused

__all__ = ["require_clear_ends", "require_in_order"]

JUMP = 5.0
"""Length of a step, in distances to the nearest other point, from which it is a jump to another side."""
BACK = 3.0
"""Distance, in distances to the nearest other point, within which the next jump returns."""
SIDE = 20
"""Most points between two jumps."""
ZIGZAG = 0.1
"""Share of points after which two jumps lead there and back, from which a table lists two sides at once."""
FEWEST = 8
"""Fewest points whose distance shows that the ends of an outline nearly meet."""


def require_in_order(points: Float[np.ndarray, "point 2"], name: str, remedy: str) -> None:
    """Refuse points that jump to and fro between two sides, as a list of edge pixels row by row does.

    Args:
        points: Points in the order of the file, mm or pixels.
        name: Name of the file in messages.
        remedy: What to do.

    Raises:
        Unreadable: The points jump to and fro.
    """
    steps = np.diff(points, axis=0)
    if len(points) < SIDE or not np.isfinite(points).all() or any(_one_way(steps[:, k]) for k in (0, 1)):
        return
    nearest = cKDTree(points).query(points, k=2)[0][:, 1]
    jumps = np.flatnonzero(np.linalg.norm(steps, axis=1) > JUMP * np.maximum(nearest[:-1], nearest[1:]))
    there, back = jumps[:-1], jumps[1:]
    gap = np.linalg.norm(points[there] - points[back + 1], axis=1)
    returns = there[(back - there <= SIDE) & (gap <= BACK * np.maximum(nearest[there], nearest[back + 1]))]
    if len(returns) > ZIGZAG * len(points) + 1:
        first = int(returns[0])
        raise refused(
            f"{name} jumps to and fro between two sides",
            f"e.g. from {points[first].tolist()} to {points[first + 1].tolist()} and back",
            "points in their order along the interface",
            remedy,
        )


def _one_way(steps: Float[np.ndarray, " step"]) -> bool:
    return bool((steps > 0).all() or (steps < 0).all())


def require_clear_ends(chain: Float[np.ndarray, "point 2"], name: str) -> None:
    """Refuse an outline whose ends are as near to each other as neighbours are: it may be closed.

    Raises:
        Unreadable: Its ends nearly meet.
    """
    if len(chain) < FEWEST:
        return
    lengths = np.linalg.norm(np.diff(chain, axis=0), axis=1)
    gap, usual = float(np.linalg.norm(chain[0] - chain[-1])), float(np.median(lengths))
    if gap <= max(2 * usual, min(float(lengths.max()), 5 * usual)):
        raise refused(
            f"{name} ends near its first point and does not repeat it",
            f"{gap:.3g} mm apart, neighbours {usual:.3g} mm",
            "an outline that is clearly open or closed",
            "Say `closed: true`, as for outlines of OpenCV, or `closed: false`.",
        )
