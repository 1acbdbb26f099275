"""The parts of a specimen on its undeformed mesh (Fig. 11)."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch

from strandline.report.plots.style import (
    DOUBLE,
    axes_or_new,
    styled,
)

__all__ = ["plot_parts"]

COLOURS = ("#dbe9f4", "#7fb3d5", "#f0b27a", "#82c39b", "#c39bd3", "#f7dc6f")


def plot_parts(
    points: Float[np.ndarray, "point 2"],
    cells: Mapping[str, Int[np.ndarray, "_ 3"]],
    *,
    ax: Axes | None = None,
) -> Axes:
    """Draw the triangles of each part in its own colour.

    Args:
        points: vertices of the mesh, mm.
        cells: vertex numbers of the triangles by name of the part, in the order of the legend; at most six parts.
        ax: axes to draw in.
    """
    with styled():
        ax = axes_or_new(ax, (DOUBLE, 3.8))
        for (_, triangles), colour in zip(cells.items(), COLOURS, strict=False):
            shade, faces = ListedColormap([colour]), np.zeros(len(triangles))
            x, y = points.T
            ax.tripcolor(x, y, triangles, facecolors=faces, cmap=shade, edgecolors="0.4", lw=0.3, rasterized=True)
        handles = [Patch(facecolor=colour, edgecolor="0.4") for colour in COLOURS[: len(cells)]]
        ax.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]")
        ax.legend(handles, list(cells), loc="upper right", ncols=len(cells))
    return ax
