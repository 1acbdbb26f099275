"""How good a surrogate is, what its inputs explain, and how a posterior took shape: with more runs, in the sampler."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from strandline.posterior import SobolIndices
from strandline.report.plots import style


@style.drawn(style.SINGLE, 3.4)
def plot_leave_one_out(
    value: Float[np.ndarray, " run"],
    prediction: Float[np.ndarray, " run"],
    *,
    sd: Float[np.ndarray, " run"] | None = None,
    near_mode: Bool[np.ndarray, " run"] | None = None,
    left_out: str = "leave-one-out",
    ax: Axes = style.NEW,
) -> Axes:
    """Draw predictions of log-likelihoods, each without that run, against their values; on the diagonal they agree.

    `sd`, that of the predictions, is drawn as error bars; points near the mode, which decide the posterior, are
    highlighted. `left_out` says how the predictions were made: ``leave-one-out`` or ``leave-a-tenth-out``.
    """
    near = np.zeros(len(value), bool) if near_mode is None else near_mode
    both = np.concatenate([value, prediction])
    margin = 0.04 * (np.ptp(both) or 1.0)
    limits = (both.min() - margin, both.max() + margin)
    ax.plot(limits, limits, color=style.BLACK, linewidth=0.8, label="agreement")
    for chosen, colour, size, label in (
        (~near, style.GREY, 3.0, "other runs"),
        (near, style.RED, 3.5, "runs near the mode"),
    ):
        if chosen.any():
            error = None if sd is None else sd[chosen]
            rms = float(np.sqrt(np.mean((prediction[chosen] - value[chosen]) ** 2)))
            text = f"{label}, rms error {float(f'{rms:.3g}'):g}"
            look: Any = {"fmt": "o", "color": colour, "markersize": size, "elinewidth": 0.7, "alpha": 0.6}
            ax.errorbar(value[chosen], prediction[chosen], error, label=text, **look)
    ax.set(aspect="equal", xlim=limits, ylim=limits)
    ax.locator_params(nbins=5)
    ax.set(xlabel="log-likelihood", ylabel=f"{left_out} prediction of\nlog-likelihood")
    style.below(ax)
    return ax


STYLES: tuple[dict[str, Any], ...] = ({"linewidth": 2.4, "alpha": 0.4}, {"linewidth": 1.0, "linestyle": "--"})
"""Broad and pale, then thin and broken: both can be seen where the errors are equal."""
DECADES = 1e-3
"""Lowest error shown, as a share of the largest: fixed ends have rounding errors only."""


@dataclass(frozen=True, eq=False)
class ErrorsAlong:
    """Errors at places along an interface, mm: the medians over runs, each predicted from the others, and over draws of
    the posterior, of the standard deviation that the surrogate predicts there.
    """

    arc_length: Float[np.ndarray, " point"]
    left_out: Float[np.ndarray, " point"]
    predicted: Float[np.ndarray, " point"]


@style.drawn(style.SINGLE, 3.1)
def plot_field_error(errors: Mapping[str, ErrorsAlong], *, ax: Axes = style.NEW) -> Axes:
    """Draw both errors over the arc length, logarithmic, in µm; one colour for each condition.

    More conditions than the palette has colours are taken as times, whose colours go from dark to bright.
    """
    kinds: dict[str, Any] = {}
    conditions: dict[str, Any] = {}
    for (condition, along), colour in zip(errors.items(), _colours(len(errors)), strict=True):
        lines = {"runs, each from the others": along.left_out, "its own estimate at draws": along.predicted}
        for look, (label, values) in zip(STYLES, lines.items(), strict=True):
            shown = np.where(values > 0, style.TO_MICROMETRES * values, np.nan)  # fixed ends have no error
            (line,) = ax.semilogy(along.arc_length, shown, color=colour, **look)
            kinds[label] = line if len(errors) == 1 else Line2D([], [], color=style.GREY, **look)
        conditions[condition] = Line2D([], [], color=colour, linewidth=2.4)
    highest = style.TO_MICROMETRES * max(float(np.nanmax([a.left_out, a.predicted])) for a in errors.values())
    if highest > 0:
        ax.set_ylim(bottom=max(ax.get_ylim()[0], DECADES * highest))
    ax.set(xlabel="arc length [mm]", ylabel="error of the interface [µm]")
    style.legend_under(ax.figure, kinds if len(errors) == 1 else kinds | conditions, columns=4)
    return ax


def _colours(number: int) -> list[Any]:
    if number <= len(style.CYCLE):
        return list(style.CYCLE[:number])
    return list(colormaps["viridis"](np.linspace(0.0, 0.9, number)))


HEIGHT = 0.36


@style.drawn()
def plot_sensitivity(indices: SobolIndices, names: Sequence[str], *, ax: Axes | None = None) -> Axes:
    """Draw the first-order and the total index of each input as a pair of bars, with their bootstrap intervals."""
    place = np.arange(len(names))
    kinds = (
        ("alone (first order)", style.BLUE, -0.5 * HEIGHT, indices.first, indices.first_low, indices.first_high),
        ("with others too (total)", style.ORANGE, 0.5 * HEIGHT, indices.total, indices.total_low, indices.total_high),
    )
    ax = ax or style.new_axes(style.SINGLE, 1.3 + 0.36 * len(names))
    for label, colour, shift, value, low, high in kinds:
        reach = np.maximum([value - low, high - value], 0.0)
        bars = {"ecolor": style.BLACK, "elinewidth": 0.9, "capsize": 2.0}
        ax.barh(place + shift, value, HEIGHT, xerr=reach, color=colour, label=label, error_kw=bars)
    ax.axvline(0.0, color=style.BLACK, linewidth=0.8)
    ax.set(yticks=place, yticklabels=list(names), xlabel="share of the variance under the prior")
    ax.set_xlim(min(0.0, float(np.min(indices.first_low))), max(1.0, float(np.max(indices.total_high))))
    ax.invert_yaxis()
    style.below(ax, columns=2, borderaxespad=1.4)
    return ax


Series = Sequence[float] | Float[np.ndarray, " step"]


@style.drawn()
def plot_run_history(
    runs: Float[np.ndarray, " step"],
    mean: Float[np.ndarray, "step dim"],
    sd: Float[np.ndarray, "step dim"],
    labels: Sequence[str],
    *,
    checked: Bool[np.ndarray, " step"],
    truth: Sequence[float] | None = None,
) -> Figure:
    """Draw the mean and a band of one standard deviation of each input against the number of runs.

    `labels` of the inputs have units; `checked` tells which posteriors were computed with the runs of a check as well.
    """
    figure, panels = style.panel_grid(len(labels), 2.0, columns=4, sharex=True)
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
    style.legend_under(figure, style.labelled(panels[0]))
    return figure


@style.drawn()
def plot_tempering(exponent: Series, ess: Series, acceptance: Series, *, particles: int | None = None) -> Figure:
    """Draw the sampler's tempering steps in three panels with a common x axis.

    The exponent of the likelihood, the effective sample size and the share of accepted moves are those after each step.
    A line marks half the number of particles, below which the sampler resamples.
    """
    figure = style.new_figure(style.SINGLE, 3.8)
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
