"""Fields over two inputs (Figs. 5–8), how good a surrogate is, what inputs explain, and how a posterior took shape."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float
from matplotlib import colormaps, patheffects
from matplotlib.axes import Axes
from matplotlib.colors import FuncNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from scipy.interpolate import RectBivariateSpline

from strandline.parameters import Parameter
from strandline.posterior import SobolIndices
from strandline.report.plots import style

Kind = Literal["likelihood", "log_likelihood", "sd"]
_LABELS = {
    "likelihood": "likelihood / maximum",
    "log_likelihood": "log-likelihood",
    "sd": "surrogate standard deviation",
}
_COLOURS = {"likelihood": "viridis", "log_likelihood": "viridis", "sd": "cividis"}
STEPS = 8
"""Number of steps of the contour lines."""
FINER = 4
"""Points of a likelihood for each one of its grid, along each input: 481 of them are as fine as a figure's dots."""


@dataclass(frozen=True, eq=False)
class FieldGrid:
    """A scalar on a grid of two inputs, log-likelihood or standard deviation, with the runs it was learnt from.

    `failed` are inputs of the failed runs. `detail` is the same scalar on a finer grid of a small part; a likelihood
    too narrow to be seen is shown there.
    """

    x: Parameter
    y: Parameter
    x_values: Float[np.ndarray, " x"]
    y_values: Float[np.ndarray, " y"]
    values: Float[np.ndarray, "x y"]
    failed: Float[np.ndarray, "run 2"] | None = None
    truth: Float[np.ndarray, "2"] | None = None
    detail: "FieldGrid | None" = None


@style.drawn(style.SINGLE, 2.8)
def plot_field(
    grid: FieldGrid,
    *,
    kind: Kind = "log_likelihood",
    colour_bar: bool = True,
    legend: bool = True,
    ax: Axes = style.NEW,
) -> Axes:
    """Draw a field in colours with contour lines.

    The colours and lines of a log-likelihood are equally spaced in the square root of its drop from the maximum. With
    the kind "likelihood", the values of the grid are log-likelihoods, and exp(value - maximum) is drawn. A legend
    explains the crosses and points under the axes.
    """
    detail = grid.detail if kind == "likelihood" else None
    if kind == "likelihood":
        grid, detail = _finer(grid), detail and _finer(detail)
    top = max(float(g.values.max()) for g in (grid, detail) if g is not None)
    values = np.exp(grid.values - top) if kind == "likelihood" else grid.values
    norm = _norm(values, kind)
    shading = "nearest" if kind == "likelihood" else "gouraud"  # which takes seconds for as many points
    colours: Any = {"cmap": _COLOURS[kind], "norm": norm, "shading": shading, "rasterized": True}
    drawn = ax.pcolormesh(grid.x_values, grid.y_values, values.T, **colours)
    steps = np.unique(norm.inverse(np.linspace(0.0, 1.0, STEPS + 1)[1:-1]))
    lines: Any = {"levels": steps, "colors": "white", "linewidths": 0.5, "linestyles": "solid", "alpha": 0.8}
    ax.contour(grid.x_values, grid.y_values, values.T, **lines)
    if grid.failed is not None and len(grid.failed):
        rim: Any = [patheffects.withStroke(linewidth=2.0, foreground="#303030")]
        look: Any = {"color": "#c8c8c8", "markersize": 4.5, "markeredgewidth": 1.2, "path_effects": rim}
        ax.plot(*grid.failed.T, "x", label="failed run", **look)
    ax.set(xlabel=grid.x.figure_label(), ylabel=grid.y.figure_label(), xlim=grid.x.interval, ylim=grid.y.interval)
    if detail is not None and (place := _corner(ax, detail)) is not None:
        _draw_detail(ax.inset_axes(place), ax, detail, np.exp(detail.values - top), lines)
    elif grid.truth is not None:
        style.mark(ax, grid.truth, style.RED, "ground truth", marker="o")
    if colour_bar:
        bar = ax.figure.colorbar(drawn, ax=ax, label=_LABELS[kind])
        if isinstance(norm, FuncNorm):
            places, labels = style.root_ticks(norm.inverse(0.0), norm.inverse(1.0))
            bar.set_ticks(places, labels=labels)
    if legend:
        style.below(ax)
    return ax


@style.drawn()
def three_measures(fields: Mapping[str, FieldGrid], *, kind: Kind = "likelihood") -> Figure:
    """Draw fields side by side, titled by their keys: (a), (b), (c); only normalised likelihoods share a colour bar."""
    shared = kind == "likelihood"
    width, height = style.SINGLE if len(fields) == 1 else style.DOUBLE, 2.9 if len(fields) < 3 else 2.4
    figure = style.new_figure(width, height)
    panels = figure.subplots(1, len(fields), sharey=True, squeeze=False)[0]
    for letter, ax, (title, grid) in zip("abcdefgh", panels, fields.items(), strict=False):
        plot_field(grid, kind=kind, colour_bar=not shared, legend=False, ax=ax)
        ax.set_title(f"({letter}) {title}" if len(fields) > 1 else title)
        ax.label_outer()
    for bar in [ax for ax in figure.axes if ax not in panels][:-1]:
        bar.set_ylabel("")  # that of the rightmost one is enough
    if shared:
        figure.colorbar(panels[0].collections[0], ax=list(panels), label=_LABELS[kind], pad=0.01)
    style.legend_under(figure, style.labelled(panels[0]))
    return figure


def _finer(grid: FieldGrid) -> FieldGrid:
    """Return a log-likelihood also between its points: it is smooth where its exponential is narrower than a cell."""
    if not np.isfinite(grid.values).all():
        return grid
    given = grid.x_values, grid.y_values
    x, y = (np.linspace(one[0], one[-1], FINER * (len(one) - 1) + 1) for one in given)
    return replace(grid, x_values=x, y_values=y, values=RectBivariateSpline(*given, grid.values)(x, y))


def _norm(values: Float[np.ndarray, "x y"], kind: Kind) -> Normalize:
    top = float(values.max())
    if kind == "likelihood":
        return Normalize(0.0, 1.0)
    if kind == "sd":
        return Normalize(0.0, top or 1.0)
    return FuncNorm(style.root_scale(top), vmin=min(float(values.min()), top - 1e-9), vmax=top)


def _draw_detail(
    inset: Axes, ax: Axes, detail: FieldGrid, values: Float[np.ndarray, "x y"], lines: Mapping[str, Any]
) -> None:
    """Draw a small part of the field enlarged in `inset`, with a frame around that part."""
    colours: Any = {"cmap": _COLOURS["likelihood"], "norm": Normalize(0.0, 1.0), "shading": "nearest"}
    inset.pcolormesh(detail.x_values, detail.y_values, values.T, rasterized=True, **colours)
    inset.contour(detail.x_values, detail.y_values, values.T, **lines)
    if detail.truth is not None:
        style.mark(inset, detail.truth, style.RED, "ground truth", marker="o", size=6.0)
        style.mark(ax, [np.nan, np.nan], style.RED, "ground truth", marker="o")  # for the legend
    inset.tick_params(colors="white", labelsize=6.5, length=2.5)
    inset.locator_params(nbins=4, prune="both")  # labels at the ends would cross the frame
    for spine in inset.spines.values():
        spine.set(visible=True, color="white")
    x, y = detail.x_values, detail.y_values
    ax.indicate_inset((x[0], y[0], x[-1] - x[0], y[-1] - y[0]), edgecolor="white", alpha=0.9)  # lines would cross it


def _corner(ax: Axes, detail: FieldGrid) -> tuple[float, float, float, float] | None:
    """Return a place for an inset, in shares of the axes: the corner farthest from the enlarged part; None if all of
    them overlap it.
    """
    x, y = detail.x_values, detail.y_values
    (x0, y0), (x1, y1) = ax.transLimits.transform([(x[0], y[0]), (x[-1], y[-1])])
    for width, height in ((0.5, 0.45), (0.35, 0.35)):
        corners = list(product((0.14, 0.97 - width), (0.13, 0.95 - height)))  # with room for tick labels
        gaps = [max(left - x1, x0 - left - width, low - y1, y0 - low - height) for left, low in corners]
        if max(gaps) > 0:
            return *corners[int(np.argmax(gaps))], width, height
    return None


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
    kinds = (~near, style.GREY, 3.0, "other runs"), (near, style.RED, 3.5, "runs near the mode")
    for chosen, colour, size, label in kinds:
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
    lowest = DECADES * max(float(np.nanmax([a.left_out, a.predicted])) for a in errors.values())
    for (condition, along), colour in zip(errors.items(), _colours(len(errors)), strict=True):
        lines = {"runs, each from the others": along.left_out, "its own estimate at draws": along.predicted}
        for look, (label, values) in zip(STYLES, lines.items(), strict=True):
            shown = np.where(values > lowest, style.TO_MICROMETRES * values, np.nan)
            (line,) = ax.semilogy(along.arc_length, shown, color=colour, **look)
            kinds[label] = line if len(errors) == 1 else Line2D([], [], color=style.GREY, **look)
        conditions[condition] = Line2D([], [], color=colour, linewidth=2.4)
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
        ax.axhline(middle[-1], color=style.BLACK, linewidth=0.4, label="last mean")
    style.legend_under(figure, style.labelled(panels[0]), columns=5)
    return figure


@style.drawn()
def plot_tempering(exponent: Series, ess: Series, acceptance: Series, *, particles: int | None = None) -> Figure:
    """Draw the sampler's tempering steps in three panels with a common x axis.

    The exponent of the likelihood, the effective sample size and the share of accepted moves are those after each step.
    A line marks half the number of particles, below which the sampler resamples.
    """
    figure = style.new_figure(style.SINGLE, 3.8)
    panels = figure.subplots(3, 1, sharex=True)
    labels = ("tempering\nexponent", "effective\nsample size", "acceptance")
    looks = zip(labels, (style.BLUE, style.GREEN, style.RED), ((0, 1.05), (0, None), (0, 1)), strict=True)
    for ax, values, (label, colour, limits) in zip(panels, (exponent, ess, acceptance), looks, strict=True):
        ax.plot(np.arange(1, len(values) + 1), values, ".-", color=colour, markersize=4)
        ax.set(ylabel=label, ylim=limits)
    if particles is not None:
        panels[1].axhline(particles / 2, color=style.GREY, linestyle=":", label="resampling below")
        panels[1].legend(loc="lower right")
    panels[2].set_xlabel("tempering step")
    panels[2].xaxis.set_major_locator(MaxNLocator(integer=True))
    figure.align_ylabels(panels)
    return figure
