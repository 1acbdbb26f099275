"""Candidates for the next experiment: their expected information gain, and what they would leave unknown."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from strandline.report.plots.style import (
    BLACK,
    BLUE,
    CYCLE,
    DOUBLE,
    GREY,
    SKY,
    axes_or_new,
    figure_or_new,
    legend_under,
    styled,
)
from strandline.typeset import figure_text

__all__ = ["plot_candidates", "plot_directions"]

APART = 0.16
"""Distance of the marks of one candidate."""
MARKERS = ("o", "s", "^", "D", "v", "P", "X")


def plot_candidates(
    labels: Sequence[str],
    gains: Float[np.ndarray, " candidate"],
    errors: Float[np.ndarray, " candidate"],
    failing: Float[np.ndarray, " candidate"],
    ratios: Mapping[str, Float[np.ndarray, " candidate"]],
    *,
    figure: Figure | SubFigure | None = None,
) -> Figure | SubFigure:
    """Draw the gain of each candidate as a bar, and beside it the expected widths of the inputs.

    Args:
        labels: The candidates in words.
        gains: Expected information gains, nats.
        errors: Their standard errors.
        failing: Probabilities that the experiment fails; the part of the gain that this costs is drawn pale.
        ratios: Expected standard deviations over the present ones, by input.
        figure: Figure to draw in.
    """
    place = np.arange(len(labels))
    with styled():
        figure = figure_or_new(figure, (DOUBLE, 1.3 + 0.24 * len(labels)))
        left, right = figure.subplots(1, 2, sharey=True, width_ratios=(1.2, 1))
        bars = {"ecolor": BLACK, "elinewidth": 0.9, "capsize": 2.0}
        left.barh(place, gains, 0.6, color=SKY, alpha=0.45, label="lost where it fails")
        left.barh(place, gains * (1 - failing), 0.6, xerr=errors, color=BLUE, label="gain", error_kw=bars)
        left.set(xlabel="expected information gain [nats]", yticks=place, yticklabels=[figure_text(a) for a in labels])
        left.set_xlim(left=0.0)
        for k, (name, ratio) in enumerate(ratios.items()):
            style = {"marker": MARKERS[k % len(MARKERS)], "color": CYCLE[k % len(CYCLE)], "linestyle": ""}
            shift = APART * (k - 0.5 * (len(ratios) - 1))
            right.plot(ratio, place + shift, markersize=4, label=figure_text(name), **style)
        right.axvline(1.0, color=GREY, linewidth=0.8, linestyle=":")
        right.set(xlabel="expected sd / present sd")
        right.set_xlim(0.0, 1.08)
        left.invert_yaxis()
        shown = [ax.get_legend_handles_labels() for ax in (left, right)]
        legend_under(figure, {label: h for handles, names in shown for h, label in zip(handles, names, strict=True)})
    return figure


def plot_directions(
    names: Sequence[str],
    weights: Float[np.ndarray, "direction dim"],
    left: Float[np.ndarray, " direction"],
    *,
    ax: Axes | None = None,
) -> Axes:
    """Draw the combinations of the inputs as columns of a matrix, with what is left of the prior's width in each.

    Args:
        names: Names of the inputs.
        weights: Unit vectors in prior standard deviations, one combination a row.
        left: Share of the prior's standard deviation that is left in each.
        ax: Axes to draw in.
    """
    number = len(names)
    with styled():
        ax = axes_or_new(ax, (1.6 + 0.5 * number, 1.2 + 0.36 * number))
        picture = ax.imshow(weights.T, cmap="RdBu_r", vmin=-1, vmax=1, aspect="auto")
        for (row, column), value in np.ndenumerate(weights.T):
            colour = "white" if abs(value) > 0.6 else BLACK
            ax.text(
                column, row, f"{value:+.2f}".replace("-", "−"), ha="center", va="center", fontsize=6.5, color=colour
            )
        ax.set_xticks(range(len(left)), [f"{100 * share:.0f} %" for share in left])
        ax.set_yticks(range(number), [figure_text(name) for name in names])
        ax.set(xlabel="prior width left in each combination")
        ax.figure.colorbar(picture, ax=ax, label="weight", shrink=0.9)
    return ax
