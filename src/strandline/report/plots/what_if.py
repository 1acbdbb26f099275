"""Other assumptions: the interval of each input under each of them, beside the present one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import MaxNLocator

from strandline.report.plots.style import BLUE, DOUBLE, GREY, RED, SINGLE, SKY, figure_or_new, legend_under, styled

__all__ = ["Whisker", "plot_alternatives"]

COLUMNS = 3
ROW, AROUND = 0.17, 0.75
"""Heights of a row and of what is above and below the rows, inches."""
LABELLED = 1.9
"""Width of the names, inches."""


@dataclass(frozen=True)
class Whisker:
    """Mean and 90 % interval of an input.

    Args:
        mean: Mean.
        low: Lower end of the interval.
        high: Upper end of it.
        moves: Whether it differs from the present posterior by more than what counts.
    """

    mean: float
    low: float
    high: float
    moves: bool = False


def plot_alternatives(
    present: Mapping[str, Whisker],
    alternatives: Sequence[tuple[str, Sequence[Whisker | None]]],
    *,
    figure: Figure | SubFigure | None = None,
) -> Figure | SubFigure:
    """Draw mean and interval of each input under each alternative, over a band for the present posterior.

    Args:
        present: The present posterior by the label of the input.
        alternatives: The name of each, with what becomes of each input; None if it is fixed.
        figure: Figure to draw in.
    """
    columns = min(COLUMNS, len(present))
    rows = -(-len(present) // columns)
    height = rows * (ROW * (len(alternatives) + 1) + AROUND) + 0.3
    with styled():
        figure = figure_or_new(figure, (DOUBLE if columns > 1 else SINGLE + LABELLED, height))
        panels = figure.subplots(rows, columns, squeeze=False, sharey=True).ravel()
        for i, (ax, (label, band)) in enumerate(zip(panels, present.items(), strict=False)):
            _panel(ax, band, [some[i] for _, some in alternatives])
            ax.set_xlabel(label)
        panels[0].set_yticks(range(len(alternatives)), [name for name, _ in alternatives])
        panels[0].set_ylim(len(alternatives) - 0.4, -0.6)
        for ax in panels[len(present) :]:
            ax.remove()
        shown = [ax.get_legend_handles_labels() for ax in panels[: len(present)]]
        legend_under(figure, {label: h for handles, labels in shown for h, label in zip(handles, labels, strict=True)})
    return figure


def _panel(ax: Axes, band: Whisker, some: Sequence[Whisker | None]) -> None:
    ax.axvspan(band.low, band.high, color=SKY, alpha=0.35, linewidth=0, label="present 90 % interval")
    ax.axvline(band.mean, color=GREY, linewidth=0.8, label="present mean")
    for moves, colour, label in ((False, BLUE, "mean and 90 % interval"), (True, RED, "mean and 90 % interval, moved")):
        chosen = [(k, one) for k, one in enumerate(some) if one is not None and one.moves == moves]
        if not chosen:
            continue
        mean, low, high = np.array([(one.mean, one.low, one.high) for _, one in chosen]).T
        reach = np.maximum([mean - low, high - mean], 0.0)
        places = [k for k, _ in chosen]
        ax.errorbar(mean, places, xerr=reach, fmt="o", color=colour, markersize=3, linewidth=1.0, label=label)
    ax.xaxis.set_major_locator(MaxNLocator(4))
    ax.tick_params(axis="y", length=0)
