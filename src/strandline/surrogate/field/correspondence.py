"""Interfaces as fields over common points: node by node if the nodes correspond, else by a common parametrisation.

Polylines are compared at equal shares of their arclength, triangulated surfaces at the projected nodes of one of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from strandline.errors import NoCommonPoints
from strandline.interface import Interface
from strandline.surrogate.field.projection import Reference, common_reference

__all__ = ["Layout", "common_layout", "fields_of", "registered"]

FEWEST_POINTS = 33
"""Smallest number of points of an interface taken at equal shares of its arclength."""


@dataclass(frozen=True, eq=False)
class Layout:
    """The meaning of the points of one condition's interface in all runs.

    Args:
        template: An interface that has these points, for its cells and the weights of its points.
        way: Points used: the nodes if they correspond; otherwise points at equal shares of the arclength of a polyline,
            or the template's nodes projected onto a surface.
        reference: The template, to project onto surfaces; None for the other ways.
    """

    template: Interface
    way: Literal["nodes", "arclength", "projection"]
    reference: Reference | None = None

    @property
    def weights(self) -> Float[np.ndarray, " point"]:
        """Share of the interface's length (area) that each point stands for; they sum to 1."""
        interface = self.template
        shares = np.repeat(interface.sizes / interface.dim, interface.dim)
        size = np.bincount(interface.cells.ravel(), weights=shares, minlength=len(interface.points))
        return np.asarray(size / size.sum())

    def with_points(self, points: Float[np.ndarray, "point xyz"]) -> Interface:
        """Return the interface with other points in the same order."""
        return Interface(points, self.template.cells)


def common_layout(interfaces: Sequence[Interface]) -> Layout:
    """Return the layout that all of these interfaces can be brought to.

    Raises:
        NoCommonPoints: they have no common parametrisation: polylines and surfaces, or open and closed ones,
            together; surfaces that are too different to be projected onto each other.
    """
    first = interfaces[0]
    same = all(one.points.shape == first.points.shape and np.array_equal(one.cells, first.cells) for one in interfaces)
    if same:
        return Layout(first, "nodes")
    if len({one.dim for one in interfaces}) > 1:
        raise _different("polylines in some runs, surfaces in others")
    if first.dim == 3:
        reference = common_reference(interfaces)
        if isinstance(reference, str):
            raise _different(reference)
        return Layout(reference.surface, "projection", reference)
    if len({one.closed for one in interfaces}) > 1:
        raise _different("open polylines in some runs, closed ones in others")
    number = max(FEWEST_POINTS, max(len(one.points) for one in interfaces))
    return Layout(first.resampled(number), "arclength")


def registered(interface: Interface, layout: Layout) -> tuple[Float[np.ndarray, "point xyz"], float]:
    """Return the points of `interface` in the layout, and the root mean square error that this causes, mm.

    The error is the distance of the interface's own nodes from the polyline or the triangles through the points.

    Raises:
        NoCommonPoints: it does not fit the layout.
    """
    if layout.reference is not None:
        if interface.dim != 3:
            raise _different("a polyline where the others are surfaces")
        found = layout.reference.on(interface)
        if isinstance(found, str):
            raise _different(found)
        return found.points, found.error
    if layout.way == "nodes":
        if interface.points.shape != layout.template.points.shape:
            raise _different("a different number of points than the other runs")
        return interface.points, 0.0
    if interface.dim != 2 or interface.closed != layout.template.closed:
        raise _different("a polyline that is open or closed where the others are not")
    turned = interface.reversed() if interface.runs_against(layout.template) else interface
    number = len(layout.template.points)
    if turned.closed:
        turned = _same_start(turned, layout.template)
    taken = turned.resampled(number)
    return taken.points, float(np.sqrt(np.mean(_squares(turned.points, taken))))


def fields_of(
    runs: Sequence[Mapping[str, Interface]], layouts: Mapping[str, Layout]
) -> tuple[Float[np.ndarray, "run value"], float]:
    """Return the coordinates of the points of all conditions, one row per run, and the worst registration error, mm."""
    rows, worst = [], 0.0
    for run in runs:
        parts = []
        for name, layout in layouts.items():
            points, error = registered(run[name], layout)
            parts.append(points.ravel())
            worst = max(worst, error)
        rows.append(np.concatenate(parts))
    return np.array(rows), worst


def _same_start(interface: Interface, template: Interface) -> Interface:
    """Return a closed polyline that begins at its node nearest to where the template begins."""
    start = template.points[template.cells[0, 0]]
    chain = interface.points[interface.cells[:, 0]]
    first = int(np.argmin(np.sum((chain - start) ** 2, axis=1)))
    return Interface.polyline(np.roll(chain, -first, axis=0), closed=True)


def _squares(points: Float[np.ndarray, "point 2"], target: Interface) -> Float[np.ndarray, " point"]:
    """Return the squared distance of each point from the segments of `target`, mm²."""
    a, d = target.starts, target.ends - target.starts
    offset = points[:, None, :] - a
    share = np.clip(np.sum(offset * d, axis=2) / np.sum(d * d, axis=1), 0.0, 1.0)
    return np.asarray(np.min(np.sum((offset - share[..., None] * d) ** 2, axis=2), axis=1))


def _different(found: str) -> NoCommonPoints:
    return NoCommonPoints(
        "interfaces of the runs for a surrogate of the field",
        value=found,
        expected="interfaces with a common parametrisation",
        remedy="Use the surrogate of the log-likelihood: surrogate: {log_likelihood: {}}.",
    )
