"""Where on a simulated interface the observed points lie: a prediction at other inputs is observed at the same places.

A polyline is followed by its arc length, so that noise along it moves no point past its neighbour. The points of a
surface keep their place within its triangles.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from strandline.discrepancy.nearest import closest_points
from strandline.interface import Interface

__all__ = ["Footprint", "footprint"]

WHOLE = 0.8
"""Share of a polyline from which an observation of as many points consists of its nodes."""


@dataclass(frozen=True, eq=False)
class Footprint:
    """The observed points as weighted means of the nodes of a simulated interface.

    Args:
        corners: Numbers of the nodes around each observed point, shape (point, corner).
        weights: Their weights, which sum to 1 for each point, shape (point, corner).
        cells: Cells of the observed interface, shape (cell, end).
    """

    corners: Int[np.ndarray, "point corner"]
    weights: Float[np.ndarray, "point corner"]
    cells: Int[np.ndarray, "cell end"]

    def on(self, nodes: Float[np.ndarray, "node xyz"]) -> Float[np.ndarray, "point xyz"]:
        """Return the observed points on a simulated interface with these nodes; it is linear in them."""
        return np.asarray(np.einsum("pc,pcx->px", self.weights, nodes[self.corners]))


def footprint(observed: Interface, simulated: Interface) -> Footprint:
    """Return where the points of `observed` lie on `simulated`, an interface near it that runs the same way."""
    same = observed.points.shape == simulated.points.shape and np.array_equal(observed.cells, simulated.cells)
    if same and (observed.dim == 3 or _covers(observed, simulated)):
        numbers = np.arange(len(observed.points))[:, None]
        return Footprint(numbers, np.ones(numbers.shape), observed.cells)
    return _on_surface(observed, simulated) if observed.dim == 3 else _on_polyline(observed, simulated)


def _covers(observed: Interface, simulated: Interface) -> bool:
    begin, end = _part(observed, simulated)
    return end - begin >= WHOLE * float(simulated.lengths.sum())


def _on_polyline(observed: Interface, simulated: Interface) -> Footprint:
    begin, end = _part(observed, simulated)
    along = _arc_lengths(observed)
    chain = np.append(observed.cells[:, 0], observed.cells[-1, 1])
    places = np.zeros(len(observed.points))
    places[chain[::-1]] = begin + (end - begin) * along[::-1] / along[-1]
    bounds, lengths = _arc_lengths(simulated), simulated.lengths
    places = places % bounds[-1] if simulated.closed else np.clip(places, 0.0, bounds[-1])
    cells = np.clip(np.searchsorted(bounds, places, side="right") - 1, 0, len(lengths) - 1)
    share = np.clip((places - bounds[cells]) / lengths[cells], 0.0, 1.0)
    return Footprint(simulated.cells[cells], np.stack([1 - share, share], axis=1), observed.cells)


def _part(observed: Interface, simulated: Interface) -> tuple[float, float]:
    """Return the arc lengths on `simulated` between which `observed` lies, mm.

    The second exceeds the whole length if the part goes past the point where a closed polyline begins.
    """
    whole = float(simulated.lengths.sum())
    ends = observed.points[[observed.cells[0, 0], observed.cells[-1, 1]]]
    found = closest_points(ends, simulated)
    on_cell = np.linalg.norm(found.points - simulated.starts[found.cells], axis=1)
    begin, end = (_arc_lengths(simulated)[found.cells] + on_cell).tolist()
    if observed.closed:
        return (begin, begin + whole) if simulated.closed else (0.0, whole)
    if simulated.closed:
        return begin, end if end > begin else end + whole
    return (begin, end) if end > begin else (0.0, whole)


def _arc_lengths(polyline: Interface) -> Float[np.ndarray, " corner"]:
    return np.concatenate([[0.0], np.cumsum(polyline.lengths)])


def _on_surface(observed: Interface, simulated: Interface) -> Footprint:
    """Return the places by the areas opposite to the corners of the closest triangles."""
    found = closest_points(observed.points, simulated)
    corners = simulated.cells[found.cells]
    a, b, c = (simulated.points[corners[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    size = np.einsum("px,px->p", normal, normal)
    first = np.einsum("px,px->p", np.cross(b - found.points, c - found.points), normal) / size
    second = np.einsum("px,px->p", np.cross(c - found.points, a - found.points), normal) / size
    return Footprint(corners, np.stack([first, second, 1 - first - second], axis=1), observed.cells)
