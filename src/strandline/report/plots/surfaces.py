"""Surfaces cut by three planes: observed and simulated ones, and the one found in a stack of pictures."""

from collections.abc import Mapping

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure, SubFigure

from strandline.imaging import Stack
from strandline.imaging.surfaces.mesh import Mesh, cut
from strandline.interface import Interface
from strandline.report.plots import style
from strandline.report.plots.style import figure_or_new, legend_under, styled

AXES = "xyz"
DARKEST = 0.5, 99.5
"""Percentiles of the grey values that are shown black and white."""


def plot_surfaces(
    observed: Interface, simulated: Mapping[str, Interface], *, figure: Figure | SubFigure | None = None
) -> Figure | SubFigure:
    """Draw where planes at right angles to the axes, through the middle of an observed surface, cut it and simulated
    ones, mm.
    """
    middle = 0.5 * (observed.points.min(axis=0) + observed.points.max(axis=0))
    shown = {"observed": (observed, style.BLACK, 1.6)}
    shown |= {label: (one, style.CYCLE[k % len(style.CYCLE)], 0.9) for k, (label, one) in enumerate(simulated.items())}
    with styled():
        figure = figure_or_new(figure, (style.DOUBLE, 2.9))
        lines = {}
        for ax, (normal, across, up) in zip(figure.subplots(1, 3), ((2, 0, 1), (1, 0, 2), (0, 1, 2)), strict=True):
            for label, (surface, colour, width) in shown.items():
                segments = cut(Mesh(surface.points, surface.cells), normal, float(middle[normal]))[:, :, [across, up]]
                lines[label] = LineCollection(list(segments), colors=colour, linewidths=width, label=label)
                ax.add_collection(lines[label])
            ax.autoscale()
            ax.set(xlabel=f"{AXES[across]} [mm]", ylabel=f"{AXES[up]} [mm]", aspect="equal")
            ax.set_title(f"{AXES[normal]} = {middle[normal]:.3g} mm")
        legend_under(figure, lines)
    return figure


def plot_stack(stack: Stack, mesh: Mesh, *, figure: Figure | SubFigure | None = None) -> Figure | SubFigure:
    """Draw three slices of a stack through the middle of a surface, in voxels, at right angles to each axis."""
    middle = np.rint(0.5 * (mesh.points.min(axis=0) + mesh.points.max(axis=0))).astype(int)
    with styled():
        figure = figure_or_new(figure, (style.DOUBLE, 2.6))
        for ax, (normal, across, down) in zip(figure.subplots(1, 3), ((2, 0, 1), (1, 0, 2), (0, 2, 1)), strict=True):
            place = int(np.clip(middle[normal], 0, stack.values.shape[2 - normal] - 1))
            grey = stack.values.take(place, axis=2 - normal)
            grey = grey if across < down else grey.T
            black, white = np.percentile(grey, DARKEST)
            ax.imshow(grey, cmap="gray", vmin=black, vmax=white, interpolation="nearest")
            segments = cut(mesh, normal, place + 1e-6)[:, :, [across, down]]
            ax.add_collection(LineCollection(list(segments), colors=style.GREEN, linewidths=0.8))
            ax.set(xlabel=f"{AXES[across]} [voxels]", ylabel=f"{AXES[down]} [voxels]")
            ax.set(title=f"{AXES[normal]} = {place}", aspect=stack.voxel[down] / stack.voxel[across])
    return figure
