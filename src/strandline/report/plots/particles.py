"""The particles themselves, size and colour by weight (Fig. 9b)."""

import numpy as np
from matplotlib.axes import Axes

from strandline.posterior import Posterior
from strandline.report.plots.style import (
    SINGLE,
    axes_or_new,
    figure_of,
    styled,
)
from strandline.report.plots.view import shown_interval

__all__ = ["plot_particles"]


def plot_particles(
    posterior: Posterior, names: tuple[str, str], *, largest: float = 16.0, ax: Axes | None = None
) -> Axes:
    """Draw the particles in the plane of two inputs; the area of a circle is proportional to its weight.

    Args:
        posterior: the weighted draws.
        names: the inputs along x and y.
        largest: area of the heaviest particle's circle, points².
        ax: axes to draw in.
    """
    order = np.argsort(posterior.weights)
    weights, points = posterior.weights[order], posterior.columns(names)[order]
    x, y = posterior.space[names[0]], posterior.space[names[1]]
    across, up = (shown_interval(posterior, name) for name in names)
    with styled():
        ax = axes_or_new(ax, (SINGLE, 2.8))
        area = largest * weights / weights.max()
        drawn = ax.scatter(points[:, 0], points[:, 1], s=area, c=weights, cmap="viridis_r", vmin=0.0, rasterized=True)
        drawn.set(edgecolors="white", linewidths=0.15)
        ax.set(xlabel=x.figure_label(), ylabel=y.figure_label(), xlim=across, ylim=up)
        figure_of(ax).colorbar(drawn, ax=ax, label="weight of the particle")
    return ax
