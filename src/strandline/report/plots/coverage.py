"""Repeated experiments: ranks of the truths with their bands, and how often intervals contain the truths."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from strandline.posterior.uniformity import Band
from strandline.report.plots.style import (
    BLUE,
    CYCLE,
    DOUBLE,
    GREY,
    RED,
    SINGLE,
    SKY,
    axes_or_new,
    below,
    figure_or_new,
    legend_under,
    styled,
)
from strandline.typeset import figure_text

__all__ = ["IntervalCoverage", "plot_intervals", "plot_rank_band", "plot_rank_bands"]

COLUMNS = 3
APART = 0.12
"""Distance of the marks of one input."""


@dataclass(frozen=True)
class IntervalCoverage:
    """How often intervals of one probability contain the truth.

    Args:
        level: Nominal probability.
        found: Share that contain it.
        low: Lower end of an interval for that share.
        high: Upper end of it.
    """

    level: float
    found: float
    low: float
    high: float


def plot_rank_bands(bands: Mapping[str, Band], *, figure: Figure | SubFigure | None = None) -> Figure | SubFigure:
    """Draw `plot_rank_band` for each input, three in a row."""
    columns = min(COLUMNS, len(bands))
    rows = -(-len(bands) // columns)
    with styled():
        figure = figure_or_new(figure, (SINGLE if columns == 1 else DOUBLE, 2.2 * rows + 0.5))
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for ax, (name, band) in zip(panels, bands.items(), strict=False):
            plot_rank_band(band, legend=False, ax=ax).set_title(figure_text(name))
        for ax in panels[len(bands) :]:
            ax.remove()
        shown = [ax.get_legend_handles_labels() for ax in panels[: len(bands)]]
        legend_under(figure, {label: h for handles, labels in shown for h, label in zip(handles, labels, strict=True)})
    return figure


def plot_rank_band(band: Band, *, legend: bool = True, ax: Axes | None = None) -> Axes:
    """Draw how far the distribution of the ranks is from uniform, and the band that it must stay inside."""
    with styled():
        ax = axes_or_new(ax, (SINGLE, 2.7))
        ax.fill_between(
            band.places,
            band.low - band.places,
            band.high - band.places,
            color=SKY,
            alpha=0.6,
            linewidth=0,
            label="95 % band",
        )
        ax.axhline(0.0, color=GREY, linewidth=0.8)
        colour, label = (BLUE, "ranks") if band.inside else (RED, "ranks that leave it")
        ax.plot(band.places, band.found - band.places, color=colour, label=label)
        ax.set(xlabel="rank of the truth", ylabel="share below minus rank", xlim=(0, 1))
        if legend:
            below(ax)
    return ax


def plot_intervals(found: Mapping[str, Sequence[IntervalCoverage]], *, ax: Axes | None = None) -> Axes:
    """Draw the share of intervals that contain the truth, for each input and probability."""
    with styled():
        ax = axes_or_new(ax, (SINGLE, 2.7))
        levels = [one.level for one in next(iter(found.values()))]
        for k, (level, colour) in enumerate(zip(levels, CYCLE, strict=False)):
            some = [several[k] for several in found.values()]
            share = np.array([one.found for one in some])
            reach = [share - [one.low for one in some], [one.high for one in some] - share]
            places = np.arange(len(some)) + APART * (k - 0.5 * (len(levels) - 1))
            ax.axhline(level, color=colour, linewidth=0.8, linestyle=":")
            label = f"{100 * level:.0f} % intervals"
            ax.errorbar(places, share, np.maximum(reach, 0.0), fmt="o", color=colour, markersize=4, label=label)
        ax.set_xticks(range(len(found)), [figure_text(name) for name in found])
        ax.set(ylabel="share that contain the truth", xlim=(-0.5, len(found) - 0.5), ylim=(0, 1.02))
        below(ax)
    return ax
