"""How a posterior took shape: with the number of runs, and in the sampler's steps."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import MaxNLocator

from strandline.report.plots import style
from strandline.report.plots.style import figure_or_new, labelled, legend_under, panel_grid, styled

Series = Sequence[float] | Float[np.ndarray, " step"]


def plot_run_history(
    runs: Float[np.ndarray, " step"],
    mean: Float[np.ndarray, "step dim"],
    sd: Float[np.ndarray, "step dim"],
    labels: Sequence[str],
    *,
    checked: Bool[np.ndarray, " step"],
    truth: Sequence[float] | None = None,
    figure: Figure | SubFigure | None = None,
) -> Figure | SubFigure:
    """Draw the mean and a band of one standard deviation of each input against the number of runs.

    `labels` of the inputs have units; `checked` tells which posteriors were computed with the runs of a check as well.
    """
    with styled():
        figure, panels = panel_grid(figure, len(labels), 2.0, columns=4, sharex=True)
        for k, (ax, label) in enumerate(zip(panels, labels, strict=True)):
            low, middle, high = mean[:, k] - sd[:, k], mean[:, k], mean[:, k] + sd[:, k]
            ax.fill_between(runs, low, high, color=style.SKY, alpha=0.5, linewidth=0, label="± 1 sd")
            ax.plot(runs, middle, "o-", color=style.BLUE, markersize=3, label="mean")
            if checked.any():
                ax.plot(runs[checked], middle[checked], "s", color=style.RED, markersize=5, label="after a check")
            if truth is not None:
                ax.axhline(truth[k], color=style.GREEN, linestyle="--", linewidth=1.2, label="truth")
            ax.set(xlabel="runs", ylabel=label)
            ax.xaxis.set_major_locator(MaxNLocator(5, integer=True))
            ax.axhline(middle[-1], color=style.BLACK, linewidth=0.4)
        legend_under(figure, labelled(panels[0]))
    return figure


def plot_tempering(
    exponent: Series,
    ess: Series,
    acceptance: Series,
    *,
    particles: int | None = None,
    figure: Figure | SubFigure | None = None,
) -> Figure | SubFigure:
    """Draw the sampler's tempering steps in three panels with a common x axis.

    The exponent of the likelihood, the effective sample size and the share of accepted moves are those after each step.
    A line marks half the number of particles, below which the sampler resamples.
    """
    with styled():
        figure = figure_or_new(figure, (style.SINGLE, 3.8))
        panels = figure.subplots(3, 1, sharex=True)
        for ax, values, colour, label, limits in zip(
            panels,
            (exponent, ess, acceptance),
            (style.BLUE, style.GREEN, style.RED),
            ("tempering\nexponent", "effective\nsample size", "acceptance"),
            ((0, 1.05), (0, None), (0, 1)),
            strict=True,
        ):
            ax.plot(np.arange(1, len(values) + 1), values, ".-", color=colour, markersize=4)
            ax.set(ylabel=label, ylim=limits)
        if particles is not None:
            panels[1].axhline(particles / 2, color=style.GREY, linestyle=":", label="resampling below")
            panels[1].legend(loc="lower right")
        panels[2].set_xlabel("tempering step")
        panels[2].xaxis.set_major_locator(MaxNLocator(integer=True))
        figure.align_ylabels(panels)
    return figure
