"""Errors of a surrogate of the interface along it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from strandline.report.plots.style import (
    CYCLE,
    GREY,
    SINGLE,
    axes_or_new,
    figure_of,
    legend_under,
    styled,
)

__all__ = ["ErrorsAlong", "plot_field_error"]

MM_TO_MICROMETRES = 1e3
STYLES: tuple[dict[str, Any], ...] = ({"linewidth": 2.4, "alpha": 0.4}, {"linewidth": 1.0, "linestyle": "--"})
"""Broad and pale, then thin and broken: both can be seen where the errors are equal."""
DECADES = 1e-3
"""Lowest error shown, as a share of the largest: fixed ends have rounding errors only."""


@dataclass(frozen=True, eq=False)
class ErrorsAlong:
    """Errors at places along an interface, mm; medians over runs or draws.

    Args:
        arc_length: Places along the interface (point,), mm.
        left_out: Errors of runs (point,), each predicted from the others.
        predicted: Standard deviations (point,) that the surrogate predicts at draws of the posterior.
    """

    arc_length: Float[np.ndarray, " point"]
    left_out: Float[np.ndarray, " point"]
    predicted: Float[np.ndarray, " point"]


def plot_field_error(errors: Mapping[str, ErrorsAlong], *, ax: Axes | None = None) -> Axes:
    """Draw both errors over the arc length, logarithmic, in µm; one colour for each condition.

    More conditions than the palette has colours are taken as times, whose colours go from dark to bright.
    """
    with styled():
        ax = axes_or_new(ax, (SINGLE, 3.1))
        kinds: dict[str, Any] = {}
        conditions: dict[str, Any] = {}
        for (condition, along), colour in zip(errors.items(), _colours(len(errors)), strict=True):
            lines = {"runs, each from the others": along.left_out, "its own estimate at draws": along.predicted}
            for style, (label, values) in zip(STYLES, lines.items(), strict=True):
                shown = np.where(values > 0, MM_TO_MICROMETRES * values, np.nan)  # fixed ends have no error
                (line,) = ax.semilogy(along.arc_length, shown, color=colour, **style)
                kinds[label] = line if len(errors) == 1 else Line2D([], [], color=GREY, **style)
            conditions[condition] = Line2D([], [], color=colour, linewidth=2.4)
        highest = MM_TO_MICROMETRES * max(float(np.nanmax([a.left_out, a.predicted])) for a in errors.values())
        if highest > 0:
            ax.set_ylim(bottom=max(ax.get_ylim()[0], DECADES * highest))
        ax.set(xlabel="arc length [mm]", ylabel="error of the interface [µm]")
        legend_under(figure_of(ax), kinds if len(errors) == 1 else kinds | conditions, columns=4)
    return ax


def _colours(number: int) -> list[Any]:
    if number <= len(CYCLE):
        return list(CYCLE[:number])
    return list(colormaps["viridis"](np.linspace(0.0, 0.9, number)))
