"""Velocity, pressure and displacement on the deformed mesh (Fig. 3)."""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure, SubFigure
from matplotlib.tri import Triangulation

from strandline.report.plots.style import (
    BLACK,
    GREY,
    SINGLE,
    figure_of,
    figure_or_new,
    styled,
)

__all__ = ["FlowFields", "plot_flow"]


@runtime_checkable
class FlowFields(Protocol):
    """The state of a fluid–solid interaction at the nodes of its deformed mesh."""

    @property
    def points(self) -> Float[np.ndarray, "point 2"]:
        """Deformed node coordinates, mm."""
        ...

    @property
    def triangles(self) -> Int[np.ndarray, "cell 3"]:
        """Node numbers of the cells."""
        ...

    @property
    def cell_part(self) -> Int[np.ndarray, " cell"]:
        """0 in the fluid, else the number of the part of the solid."""
        ...

    @property
    def velocity(self) -> Float[np.ndarray, "point 2"]:
        """Fluid velocity, mm/s."""
        ...

    @property
    def pressure(self) -> Float[np.ndarray, " point"]:
        """Fluid pressure, Pa."""
        ...

    @property
    def displacement(self) -> Float[np.ndarray, "point 2"]:
        """Displacement from the undeformed state, mm."""
        ...


def plot_flow(fields: FlowFields, *, title: str = "", figure: Figure | SubFigure | None = None) -> Figure | SubFigure:
    """Draw speed and pressure in the fluid and displacement magnitude in the solid, one below the other.

    The undeformed interface is grey; thin lines in the solid divide its parts.

    Args:
        fields: The state to draw.
        title: Title, e.g. the inputs.
        figure: Figure to draw in; a new one by default.
    """
    speed = np.linalg.norm(fields.velocity, axis=1)
    length = np.linalg.norm(fields.displacement, axis=1)
    fluid, solid = fields.cell_part == 0, fields.cell_part > 0
    with styled():
        figure = figure_or_new(figure, (SINGLE, 5.4))
        panels = figure.subplots(3, 1, sharex=True, sharey=True)
        _panel(panels[0], fields, speed, fluid, "velocity magnitude [mm/s]", "viridis")
        _panel(panels[1], fields, fields.pressure, fluid, "pressure [Pa]", "cividis")
        _panel(panels[2], fields, length, solid, "displacement magnitude [mm]", "viridis")
        panels[-1].set_xlabel("x [mm]")
        if title:
            panels[0].set_title(title)
    return figure


def interface_edges(fields: FlowFields) -> Int[np.ndarray, "edge 2"]:
    """Return the node numbers of the edges between a solid and a fluid cell."""
    return _shared(fields, fields.cell_part == 0, fields.cell_part > 0)


def inner_edges(fields: FlowFields) -> Int[np.ndarray, "edge 2"]:
    """Return the node numbers of the edges between parts of the solid."""
    parts = range(1, int(fields.cell_part.max()) + 1)
    found = [_shared(fields, fields.cell_part == k, fields.cell_part > k) for k in parts]
    return np.concatenate(found) if found else np.empty((0, 2), int)


def _shared(
    fields: FlowFields, one: Bool[np.ndarray, " cell"], other: Bool[np.ndarray, " cell"]
) -> Int[np.ndarray, "edge 2"]:
    shared = sorted(_edges(fields.triangles[one]) & _edges(fields.triangles[other]))
    return np.array(shared, int).reshape(-1, 2)


def _edges(triangles: Int[np.ndarray, "cell 3"]) -> set[tuple[int, int]]:
    pairs = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    return set(map(tuple, pairs.tolist()))


def _panel(
    ax: Axes,
    fields: FlowFields,
    values: Float[np.ndarray, " point"],
    cells: Bool[np.ndarray, " cell"],
    label: str,
    colours: str,
) -> None:
    """Draw nodal `values` on the chosen cells; the others stay pale grey."""
    x, y = fields.points.T
    others = fields.triangles[~cells]
    if len(others):
        ax.tripcolor(x, y, others, facecolors=np.zeros(len(others)), cmap="Greys", vmin=-0.15, vmax=1.0)
    if cells.any():
        mesh = Triangulation(x, y, fields.triangles[cells])
        used = values[np.unique(fields.triangles[cells])]  # nodes elsewhere must not stretch the colours
        low, high = float(used.min()), float(used.max())
        high = high if high > low else low + 1.0  # nothing moves: the lowest colour, not the middle one
        drawn = ax.tripcolor(mesh, values, shading="gouraud", cmap=colours, vmin=low, vmax=high)
        figure_of(ax).colorbar(drawn, ax=ax, label=label, shrink=0.95, pad=0.02)
    interface, rest = interface_edges(fields), fields.points - fields.displacement
    ax.add_collection(LineCollection(list(rest[interface]), colors=GREY, linewidths=0.9))
    ax.add_collection(LineCollection(list(fields.points[inner_edges(fields)]), colors=BLACK, linewidths=0.6))
    ax.add_collection(LineCollection(list(fields.points[interface]), colors=BLACK, linewidths=1.2))
    ax.margins(0.0)
    ax.set(aspect="equal", ylabel="y [mm]")
