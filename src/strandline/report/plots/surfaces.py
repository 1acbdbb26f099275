"""Observed and simulated surfaces: their outlines in three planes through the middle of the observed one."""

from collections.abc import Mapping

from matplotlib.collections import LineCollection
from matplotlib.figure import Figure, SubFigure

from strandline.imaging.surfaces.mesh import Mesh, cut
from strandline.interface import Interface
from strandline.report.plots.style import BLACK, CYCLE, DOUBLE, figure_or_new, legend_under, styled

__all__ = ["plot_surfaces"]

AXES = "xyz"


def plot_surfaces(
    observed: Interface, simulated: Mapping[str, Interface], *, figure: Figure | SubFigure | None = None
) -> Figure | SubFigure:
    """Draw where three planes at right angles to the axes cut an observed surface and simulated ones.

    Args:
        observed: The observed surface, mm; the planes run through its middle.
        simulated: Simulated surfaces by label, mm.
        figure: Figure to draw in; a new one by default.
    """
    middle = 0.5 * (observed.points.min(axis=0) + observed.points.max(axis=0))
    shown = {"observed": (observed, BLACK, 1.6)}
    colours = (CYCLE[k % len(CYCLE)] for k in range(len(simulated)))
    shown |= {label: (one, colour, 0.9) for (label, one), colour in zip(simulated.items(), colours, strict=True)}
    with styled():
        figure = figure_or_new(figure, (DOUBLE, 2.9))
        lines = {}
        for ax, (normal, across, up) in zip(figure.subplots(1, 3), ((2, 0, 1), (1, 0, 2), (0, 1, 2)), strict=True):
            for label, (surface, colour, width) in shown.items():
                segments = cut(Mesh(surface.points, surface.cells), normal, float(middle[normal]))[:, :, [across, up]]
                lines[label] = LineCollection(list(segments), colors=colour, linewidths=width, label=label)
                ax.add_collection(lines[label])
            ax.autoscale()
            ax.set(
                xlabel=f"{AXES[across]} [mm]",
                ylabel=f"{AXES[up]} [mm]",
                title=f"{AXES[normal]} = {middle[normal]:.3g} mm",
                aspect="equal",
            )
        legend_under(figure, lines)
    return figure
