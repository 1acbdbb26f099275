"""The posterior against the number of runs it is based on."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import MaxNLocator

from strandline.report.plots.style import (
    BLACK,
    BLUE,
    DOUBLE,
    GREEN,
    RED,
    SINGLE,
    SKY,
    figure_or_new,
    legend_under,
    styled,
)

__all__ = ["RunHistory", "plot_run_history"]

PER_ROW = 4


@dataclass(frozen=True, eq=False)
class RunHistory:
    """Posteriors in the order in which they were computed.

    Args:
        runs: Number of runs each posterior is based on (step,).
        mean: Posterior means (step, dim).
        sd: Posterior standard deviations (step, dim).
        checked: Whether each posterior was computed with the runs of a check as well (step,).
    """

    runs: Float[np.ndarray, " step"]
    mean: Float[np.ndarray, "step dim"]
    sd: Float[np.ndarray, "step dim"]
    checked: Sequence[bool]


def plot_run_history(
    history: RunHistory,
    labels: Sequence[str],
    *,
    truth: Sequence[float] | None = None,
    figure: Figure | SubFigure | None = None,
) -> Figure | SubFigure:
    """Draw the mean and a band of one standard deviation of each input against the number of runs.

    Args:
        history: Posteriors to draw.
        labels: Labels of the inputs, with units.
        truth: Inputs of a synthetic observation.
        figure: Figure to draw in; a new one by default.
    """
    rows, columns = -(-len(labels) // PER_ROW), min(len(labels), PER_ROW)
    with styled():
        figure = figure_or_new(figure, (SINGLE if columns == 1 else DOUBLE, 2.0 * rows + 0.5))
        axes = figure.subplots(rows, columns, squeeze=False, sharex=True)
        for k, ax in enumerate(axes.flat):
            if k >= len(labels):
                ax.set_axis_off()
                continue
            mean, sd = history.mean[:, k], history.sd[:, k]
            ax.fill_between(history.runs, mean - sd, mean + sd, color=SKY, alpha=0.5, linewidth=0, label="± 1 sd")
            ax.plot(history.runs, mean, "o-", color=BLUE, markersize=3, label="mean")
            checked = np.asarray(history.checked, bool)
            if checked.any():
                ax.plot(history.runs[checked], mean[checked], "s", color=RED, markersize=5, label="after a check")
            if truth is not None:
                ax.axhline(truth[k], color=GREEN, linestyle="--", linewidth=1.2, label="truth")
            ax.set(xlabel="runs", ylabel=labels[k])
            ax.xaxis.set_major_locator(MaxNLocator(5, integer=True))
            ax.axhline(mean[-1], color=BLACK, linewidth=0.4)
        handles, names = axes.flat[0].get_legend_handles_labels()
        legend_under(figure, dict(zip(names, handles, strict=True)))
    return figure
