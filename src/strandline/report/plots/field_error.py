"""Errors of a surrogate of the interface along it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from strandline.report.plots.style import (
    BLUE,
    CYCLE,
    SINGLE,
    axes_or_new,
    below,
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
    """Draw both errors over the arc length, logarithmic, in µm; one colour for each condition."""
    with styled():
        ax = axes_or_new(ax, (SINGLE, 2.9))
        for k, (condition, along) in enumerate(errors.items()):
            colour = CYCLE[k % len(CYCLE)] if len(errors) > 1 else BLUE
            of = f", {condition}" if condition else ""
            lines = {"runs, each from the others": along.left_out, "its own estimate at draws": along.predicted}
            for style, (label, values) in zip(STYLES, lines.items(), strict=True):
                shown = np.where(values > 0, MM_TO_MICROMETRES * values, np.nan)  # fixed ends have no error
                ax.semilogy(along.arc_length, shown, color=colour, label=label + of, **style)
        highest = MM_TO_MICROMETRES * max(float(np.nanmax([a.left_out, a.predicted])) for a in errors.values())
        if highest > 0:
            ax.set_ylim(bottom=max(ax.get_ylim()[0], DECADES * highest))
        ax.set(xlabel="arc length [mm]", ylabel="error of the interface [µm]")
        below(ax, columns=2)
    return ax
