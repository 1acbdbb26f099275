"""How the sampler went from prior to posterior: exponent, effective sample size, acceptance."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import MaxNLocator

from strandline.report.plots.style import (
    BLUE,
    GREEN,
    GREY,
    RED,
    SINGLE,
    figure_or_new,
    styled,
)

__all__ = ["plot_tempering"]

Series = Sequence[float] | Float[np.ndarray, " step"]


def plot_tempering(
    exponent: Series,
    ess: Series,
    acceptance: Series,
    *,
    particles: int | None = None,
    figure: Figure | SubFigure | None = None,
) -> Figure | SubFigure:
    """Draw the sampler's tempering steps in three panels with a common x axis.

    Args:
        exponent: exponent of the likelihood after each step (step,).
        ess: effective sample size after each step.
        acceptance: share of accepted moves in each step.
        particles: number of particles; a line marks half of it, below which the sampler resamples.
        figure: figure to draw in.
    """
    with styled():
        figure = figure_or_new(figure, (SINGLE, 3.8))
        panels = figure.subplots(3, 1, sharex=True)
        for ax, values, colour, label in zip(
            panels,
            (exponent, ess, acceptance),
            (BLUE, GREEN, RED),
            ("tempering\nexponent", "effective\nsample size", "acceptance"),
            strict=True,
        ):
            ax.plot(np.arange(1, len(values) + 1), values, ".-", color=colour, markersize=4)
            ax.set_ylabel(label)
        panels[0].set_ylim(0, 1.05)
        panels[1].set_ylim(bottom=0)
        panels[2].set_ylim(0, 1)
        if particles is not None:
            panels[1].axhline(particles / 2, color=GREY, linestyle=":", label="resampling below")
            panels[1].legend(loc="lower right")
        panels[2].set_xlabel("tempering step")
        panels[2].xaxis.set_major_locator(MaxNLocator(integer=True))
        figure.align_ylabels(panels)
    return figure
