"""Leave-one-out prediction of a surrogate against the value that was left out."""

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes

from strandline.report.plots.style import (
    BLACK,
    GREY,
    RED,
    SINGLE,
    axes_or_new,
    below,
    root_scale,
    root_ticks,
    styled,
)

__all__ = ["plot_leave_one_out"]


def plot_leave_one_out(
    value: Float[np.ndarray, " run"],
    prediction: Float[np.ndarray, " run"],
    *,
    sd: Float[np.ndarray, " run"] | None = None,
    near_mode: Bool[np.ndarray, " run"] | None = None,
    quantity: str = "log-likelihood",
    left_out: str = "leave-one-out",
    spread_top: bool = False,
    ax: Axes | None = None,
) -> Axes:
    """Draw predictions against values; on the diagonal they agree.

    Args:
        value: the quantity at each training point (run,).
        prediction: the surrogate's prediction without that point, and perhaps some others (run,).
        sd: its standard deviation there, drawn as error bars.
        near_mode: the points near the mode, which decide the posterior; highlighted.
        quantity: what is predicted, with its unit.
        left_out: how the predictions were made: ``leave-one-out`` or ``leave-a-tenth-out``.
        spread_top: draw both axes in the square root of the drop from the highest value, to see the mode of a
            log-likelihood that falls by thousands.
        ax: axes to draw in.
    """
    near = np.zeros(len(value), bool) if near_mode is None else near_mode
    with styled():
        ax = axes_or_new(ax, (SINGLE, 3.4))
        both = np.concatenate([value, prediction])
        margin = 0.04 * (np.ptp(both) or 1.0)
        limits = (both.min() - margin, both.max() + margin)
        ax.plot(limits, limits, color=BLACK, linewidth=0.8, label="agreement")
        for chosen, colour, size, label in ((~near, GREY, 3.0, "training point"), (near, RED, 3.5, "near the mode")):
            if chosen.any():
                error = None if sd is None else sd[chosen]
                text = f"{label}, rms error {_rms(prediction[chosen] - value[chosen]):.2g}"
                ax.errorbar(
                    value[chosen],
                    prediction[chosen],
                    error,
                    fmt="o",
                    color=colour,
                    markersize=size,
                    elinewidth=0.7,
                    alpha=0.6,
                    label=text,
                )
        ax.set(
            aspect="equal",
            xlim=limits,
            ylim=limits,
            xlabel=quantity,
            ylabel=f"{left_out} prediction of\n{quantity}",
        )
        if spread_top:
            ax.set(aspect="auto", box_aspect=1.0)
            _spread_top(ax, float(both.min()), float(both.max()))
        below(ax)
    return ax


def _spread_top(ax: Axes, low: float, top: float) -> None:
    """Give both axes the root scale, with a margin of a twentieth above the highest value."""
    limits = low - 0.1 * (top - low), top + 0.0025 * (top - low)
    places, labels = root_ticks(low, top)
    ax.set_xscale("function", functions=root_scale(top))
    ax.set_yscale("function", functions=root_scale(top))
    ax.set(xlim=limits, ylim=limits)
    ax.set_xticks(places, labels)
    ax.set_yticks(places, labels)
    ax.minorticks_off()


def _rms(error: Float[np.ndarray, " run"]) -> float:
    return float(np.sqrt(np.mean(error**2)))
