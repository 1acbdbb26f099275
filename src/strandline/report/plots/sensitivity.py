"""Sobol' indices of the inputs as bars."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from strandline.posterior import SobolIndices
from strandline.report.plots.style import (
    BLACK,
    BLUE,
    ORANGE,
    SINGLE,
    axes_or_new,
    below,
    styled,
)

__all__ = ["plot_sensitivity"]

HEIGHT = 0.36


def plot_sensitivity(indices: SobolIndices, names: Sequence[str], *, ax: Axes | None = None) -> Axes:
    """Draw the first-order and the total index of each input as a pair of bars, with their bootstrap intervals.

    Args:
        indices: Sobol' indices of the inputs, in the order of `names`.
        names: Names of the inputs.
        ax: Axes to draw in.
    """
    place = np.arange(len(names))
    kinds = (
        ("alone (first order)", BLUE, -0.5 * HEIGHT, indices.first, indices.first_low, indices.first_high),
        ("with others too (total)", ORANGE, 0.5 * HEIGHT, indices.total, indices.total_low, indices.total_high),
    )
    with styled():
        ax = axes_or_new(ax, (SINGLE, 1.3 + 0.36 * len(names)))
        for label, colour, shift, value, low, high in kinds:
            reach = np.maximum([value - low, high - value], 0.0)
            bars = {"ecolor": BLACK, "elinewidth": 0.9, "capsize": 2.0}
            ax.barh(place + shift, value, HEIGHT, xerr=reach, color=colour, label=label, error_kw=bars)
        ax.axvline(0.0, color=BLACK, linewidth=0.8)
        ax.set(yticks=place, yticklabels=list(names), xlabel="share of the variance under the prior")
        ax.set_xlim(min(0.0, float(np.min(indices.first_low))), max(1.0, float(np.max(indices.total_high))))
        ax.invert_yaxis()
        below(ax, columns=2, borderaxespad=1.4)
    return ax
