"""The surface found in a stack of pictures: three slices through the stack, with the outline of the surface."""

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure, SubFigure

from strandline.imaging import Stack
from strandline.imaging.surfaces.mesh import Mesh, cut
from strandline.report.plots.style import DOUBLE, GREEN, figure_or_new, styled

__all__ = ["plot_stack"]

AXES = "xyz"
DARKEST = 0.5, 99.5
"""Percentiles of the grey values that are shown black and white."""


def plot_stack(stack: Stack, mesh: Mesh, *, figure: Figure | SubFigure | None = None) -> Figure | SubFigure:
    """Draw the three slices through the middle of a surface, at right angles to each axis of the stack.

    Args:
        stack: The stack.
        mesh: The surface, in voxel coordinates.
        figure: Figure to draw in; a new one by default.
    """
    middle = np.rint(0.5 * (mesh.points.min(axis=0) + mesh.points.max(axis=0))).astype(int)
    with styled():
        figure = figure_or_new(figure, (DOUBLE, 2.6))
        for ax, (normal, across, down) in zip(figure.subplots(1, 3), ((2, 0, 1), (1, 0, 2), (0, 2, 1)), strict=True):
            place = int(np.clip(middle[normal], 0, stack.values.shape[2 - normal] - 1))
            grey = stack.values.take(place, axis=2 - normal)
            grey = grey if across < down else grey.T
            black, white = np.percentile(grey, DARKEST)
            ax.imshow(grey, cmap="gray", vmin=black, vmax=white, interpolation="nearest")
            segments = cut(mesh, normal, place + 1e-6)[:, :, [across, down]]
            ax.add_collection(LineCollection(list(segments), colors=GREEN, linewidths=0.8))
            ax.set(
                xlabel=f"{AXES[across]} [voxels]",
                ylabel=f"{AXES[down]} [voxels]",
                title=f"{AXES[normal]} = {place}",
                aspect=stack.voxel[down] / stack.voxel[across],
            )
    return figure
