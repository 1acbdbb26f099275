"""Residuals of the best fit along the observed interface, beside what the noise allows."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure, SubFigure

from strandline.report.plots.style import BLACK, DOUBLE, GREEN, RED, SKY, figure_or_new, legend_under, styled

__all__ = ["ResidualsAlong", "plot_residuals"]

MM_TO_MICROMETRES = 1e3


@dataclass(frozen=True, eq=False)
class ResidualsAlong:
    """Residuals of one observed interface, mm.

    Args:
        arc_length: Arc length at each observed point.
        residual: Signed distance of each point from the prediction.
        sd: Standard deviation that the noise allows.
        conspicuous: Ends of the parts of the arc where the residuals are too large.
    """

    arc_length: Float[np.ndarray, " point"]
    residual: Float[np.ndarray, " point"]
    sd: float
    conspicuous: tuple[tuple[float, float], ...] = ()


def plot_residuals(
    residuals: Mapping[str, ResidualsAlong], *, figure: Figure | SubFigure | None = None
) -> Figure | SubFigure:
    """Draw the residuals in µm over the arc length with a band of ± 2 standard deviations, one panel a condition.

    Args:
        residuals: Residuals by condition.
        figure: Figure to draw in; a new one by default.
    """
    with styled():
        figure = figure_or_new(figure, (DOUBLE, 0.9 + 1.9 * len(residuals)))
        panels = figure.subplots(len(residuals), 1, squeeze=False)[:, 0]
        for ax, (condition, along) in zip(panels, residuals.items(), strict=True):
            order, band = np.argsort(along.arc_length, kind="stable"), 2 * MM_TO_MICROMETRES * along.sd
            values = MM_TO_MICROMETRES * along.residual[order]
            ax.axhspan(-band, band, color=SKY, alpha=0.35, linewidth=0, label="noise, ± 2 sd")
            for k, (begin, end) in enumerate(along.conspicuous):
                label = "more than the noise allows" if k == 0 else None
                ax.axvspan(begin, end, color=RED, alpha=0.15, linewidth=0, label=label)
            ax.axhline(0.0, color=BLACK, linewidth=0.8, label="best fit")
            ax.plot(along.arc_length[order], values, color=GREEN, marker=".", markersize=3.0, label="observed")
            ax.set(ylabel="residual [µm]", title=condition)
        panels[-1].set_xlabel("arc length of the observed interface [mm]")
        parts = [ax.get_legend_handles_labels() for ax in panels]
        entries = {label: one for handles, labels in parts for one, label in zip(handles, labels, strict=True)}
        legend_under(figure, entries)
    return figure
