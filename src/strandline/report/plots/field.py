"""A scalar over two inputs: likelihood, log-likelihood or surrogate standard deviation (Figs. 5–8)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.colors import FuncNorm, Normalize
from matplotlib.figure import Figure

from strandline.parameters import Parameter
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
    top = max(float(g.values.max()) for g in (grid, detail) if g is not None)
    values = np.exp(grid.values - top) if kind == "likelihood" else grid.values
    norm = _norm(values, kind)
    colours: Any = {"cmap": _COLOURS[kind], "norm": norm, "shading": "gouraud", "rasterized": True}
    drawn = ax.pcolormesh(grid.x_values, grid.y_values, values.T, **colours)
    steps = np.unique(norm.inverse(np.linspace(0.0, 1.0, STEPS + 1)[1:-1]))
    lines: Any = {"levels": steps, "colors": "white", "linewidths": 0.5, "linestyles": "solid", "alpha": 0.8}
    ax.contour(grid.x_values, grid.y_values, values.T, **lines)
    if grid.failed is not None and len(grid.failed):
        rim: Any = [patheffects.withStroke(linewidth=2.0, foreground="#303030")]
        look: Any = {"color": "#c8c8c8", "markersize": 4.5, "markeredgewidth": 1.2, "path_effects": rim}
        ax.plot(*grid.failed.T, "x", label="failed run", **look)
    if detail is not None:
        ax.set(xlim=grid.x.interval, ylim=grid.y.interval)
        _draw_detail(ax, detail, np.exp(detail.values - top), lines)
    elif grid.truth is not None:
        style.mark(ax, grid.truth, style.RED, "ground truth", marker="o")
    ax.set(xlabel=grid.x.figure_label(), ylabel=grid.y.figure_label(), xlim=grid.x.interval, ylim=grid.y.interval)
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
    """Draw fields side by side, titled by their keys: (a), (b), (c).

    Normalised likelihoods share one colour bar; other fields have one each, since discrepancies differ in scale.
    """
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


def _norm(values: Float[np.ndarray, "x y"], kind: Kind) -> Normalize:
    top = float(values.max())
    if kind == "likelihood":
        return Normalize(0.0, 1.0)
    if kind == "sd":
        return Normalize(0.0, top or 1.0)
    return FuncNorm(style.root_scale(top), vmin=min(float(values.min()), top - 1e-9), vmax=top)


def _draw_detail(ax: Axes, detail: FieldGrid, values: Float[np.ndarray, "x y"], lines: Mapping[str, Any]) -> None:
    """Draw a small part of the field enlarged in the corner farthest from it, with a frame around that part."""
    inset = ax.inset_axes(_corner(ax, detail))
    colours: Any = {"cmap": _COLOURS["likelihood"], "norm": Normalize(0.0, 1.0), "shading": "gouraud"}
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


def _corner(ax: Axes, detail: FieldGrid) -> tuple[float, float, float, float]:
    """Return a place for an inset, in shares of the axes, away from the enlarged part."""
    middle = [0.5 * (values[0] + values[-1]) for values in (detail.x_values, detail.y_values)]
    share = [(m - low) / (high - low) for m, (low, high) in zip(middle, (ax.get_xlim(), ax.get_ylim()), strict=True)]
    return 0.47 if share[0] < 0.5 else 0.14, 0.13 if share[1] > 0.5 else 0.5, 0.5, 0.45
