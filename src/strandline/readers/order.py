"""Points of a table that are in no order along an outline, or leave open whether it is closed."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from strandline.readers.problems import refused

__all__ = ["require_clear_ends", "require_in_order"]

JUMP, BACK = 5.0, 3.0
"""Distances, in those to the nearest other point: a longer step is a jump; a jump back ends nearer to its start."""
SIDE = 20
"""Most points between a jump and the jump back."""
ZIGZAG = 0.1
"""Share of points that jump and come back, from which a table lists two sides at once."""
CLOSE, GAP = 1.5, 0.1
"""Distance of ends that nearly meet, at most, in median distances of neighbours and as a share of the length."""


def require_in_order(points: Float[np.ndarray, "point 2"], name: str, remedy: str) -> None:
    """Refuse points that jump to and fro between two sides, as a list of edge pixels row by row does."""
    steps = np.diff(points, axis=0)
    one_way = (steps > 0).all(axis=0) | (steps < 0).all(axis=0)
    if len(points) < SIDE or not np.isfinite(points).all() or one_way.any():
        return
    near = cKDTree(points).query(points, k=2)[0][:, 1]
    jumps = np.flatnonzero(np.linalg.norm(steps, axis=1) > JUMP * np.maximum(near[:-1], near[1:]))
    there, back = jumps[:-1], jumps[1:]
    gap = np.linalg.norm(points[there] - points[back + 1], axis=1)
    returns = there[(back - there <= SIDE) & (gap <= BACK * np.maximum(near[there], near[back + 1]))]
    if len(returns) > ZIGZAG * len(points) + 1:
        start, end = points[returns[0] : returns[0] + 2].tolist()
        value = f"e.g. from {start} to {end} and back"
        raise refused(f"{name} jumps to and fro between two sides", value, "points in order along the line", remedy)


def require_clear_ends(chain: Float[np.ndarray, "point 2"], name: str) -> None:
    """Refuse an outline whose ends are as near to each other as neighbours are: it may be closed."""
    if len(chain) < 3:
        return
    lengths = np.linalg.norm(np.diff(chain, axis=0), axis=1)
    gap, usual = float(np.linalg.norm(chain[0] - chain[-1])), float(np.median(lengths))
    if gap <= min(GAP * lengths.sum(), CLOSE * usual):
        value, expected = f"{gap:.3g} mm apart, neighbours {usual:.3g} mm", "an outline that is clearly open or closed"
        remedy = "Say `closed: true`, as for outlines of OpenCV, or `closed: false`."
        raise refused(f"{name} ends near its first point and does not repeat it", value, expected, remedy)
