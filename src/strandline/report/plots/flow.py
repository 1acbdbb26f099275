"""Velocity, pressure and displacement on the deformed mesh (Fig. 3)."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure, SubFigure
from matplotlib.tri import Triangulation

from strandline.report.plots import style
from strandline.report.plots.style import figure_of, figure_or_new, styled


def plot_flow(fields: Any, *, title: str = "", figure: Figure | SubFigure | None = None) -> Figure | SubFigure:
    """Draw speed and pressure in the fluid and displacement magnitude in the solid, one below the other.

    The undeformed interface is grey; thin lines in the solid divide its parts. `fields` have the form of
    `strandline.models.biofilm.fields.FlowFields`.
    """
    speed = np.linalg.norm(fields.velocity, axis=1)
    length = np.linalg.norm(fields.displacement, axis=1)
    fluid, solid = fields.cell_part == 0, fields.cell_part > 0
    with styled():
        figure = figure_or_new(figure, (style.SINGLE, 5.4))
        panels = figure.subplots(3, 1, sharex=True, sharey=True)
        _panel(panels[0], fields, speed, fluid, "velocity magnitude [mm/s]", "viridis")
        _panel(panels[1], fields, fields.pressure, fluid, "pressure [Pa]", "cividis")
        _panel(panels[2], fields, length, solid, "displacement magnitude [mm]", "viridis")
        panels[-1].set_xlabel("x [mm]")
        if title:
            panels[0].set_title(title)
    return figure


def _edges_above(fields: Any, part: int) -> set[tuple[int, int]]:
    """Return the node numbers of the edges between a part, 0 being the fluid, and those with larger numbers."""
    return _edges(fields.triangles[fields.cell_part == part]) & _edges(fields.triangles[fields.cell_part > part])


def _edges(triangles: Int[np.ndarray, "cell 3"]) -> set[tuple[int, int]]:
    pairs = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    return set(map(tuple, pairs.tolist()))


def _panel(
    ax: Axes,
    fields: Any,
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
    interface = _edges_above(fields, 0)
    inner = set[tuple[int, int]]().union(*(_edges_above(fields, k) for k in range(1, int(fields.cell_part.max()) + 1)))
    rest = fields.points - fields.displacement
    for edges, points, colour, width in (
        (interface, rest, style.GREY, 0.9),
        (inner, fields.points, style.BLACK, 0.6),
        (interface, fields.points, style.BLACK, 1.2),
    ):
        segments = points[np.array(sorted(edges), int).reshape(-1, 2)]
        ax.add_collection(LineCollection(list(segments), colors=colour, linewidths=width))
    ax.margins(0.0)
    ax.set(aspect="equal", ylabel="y [mm]")
