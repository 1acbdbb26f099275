"""A scalar over two inputs: likelihood, log-likelihood or surrogate standard deviation (Figs. 5–8)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.colors import FuncNorm, Normalize
from matplotlib.figure import Figure, SubFigure

from strandline.parameters import Parameter
from strandline.report.plots.style import (
    BLACK,
    DOUBLE,
    GREY,
    RED,
    SINGLE,
    axes_or_new,
    below,
    figure_of,
    figure_or_new,
    legend_under,
    mark,
    root_scale,
    root_ticks,
    styled,
)

__all__ = ["FieldGrid", "plot_field", "plot_profile", "three_measures"]

Kind = Literal["likelihood", "log_likelihood", "sd"]
_LABELS = {
    "likelihood": "likelihood / maximum",
    "log_likelihood": "log-likelihood",
    "sd": "surrogate standard deviation",
}
_COLOURS = {"likelihood": "viridis", "log_likelihood": "viridis", "sd": "cividis"}


@dataclass(frozen=True, eq=False)
class FieldGrid:
    """A scalar on a grid of two inputs, with the runs it was learnt from.

    Args:
        x: the input along the horizontal axis.
        y: the input along the vertical axis.
        x_values: grid of the first (x,), physical.
        y_values: grid of the second (y,), physical.
        values: the scalar (x, y): log-likelihood, or standard deviation.
        failed: inputs of the failed runs (run, 2); None for none.
        training: inputs of the successful runs (run, 2); None leaves them out.
        truth: the ground truth (2,), if there is one.
        detail: the same scalar on a finer grid of a small part; a likelihood too narrow to be seen is shown there.
    """

    x: Parameter
    y: Parameter
    x_values: Float[np.ndarray, " x"]
    y_values: Float[np.ndarray, " y"]
    values: Float[np.ndarray, "x y"]
    failed: Float[np.ndarray, "run 2"] | None = None
    training: Float[np.ndarray, "train 2"] | None = None
    truth: Float[np.ndarray, "2"] | None = None
    detail: "FieldGrid | None" = None


def plot_field(
    grid: FieldGrid,
    *,
    kind: Kind = "log_likelihood",
    levels: int = 8,
    floor: float | None = None,
    colour_bar: bool = True,
    legend: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Draw a field in colours with contour lines.

    The colours and lines of a log-likelihood are equally spaced in the square root of its drop from the maximum.

    Args:
        grid: the field; for `kind` "likelihood" its values are log-likelihoods, and exp(value - maximum) is drawn.
        kind: what the values are.
        levels: number of steps of the contour lines.
        floor: lower end of the colours; values below take the last colour.
        colour_bar: whether to draw one.
        legend: whether to explain the crosses and points under the axes.
        ax: axes to draw in.
    """
    detail = grid.detail if kind == "likelihood" else None
    top = max(float(g.values.max()) for g in (grid, detail) if g is not None)
    values = np.exp(grid.values - top) if kind == "likelihood" else grid.values
    norm = _norm(values, kind, floor)
    with styled():
        ax = axes_or_new(ax, (SINGLE, 2.8))
        drawn = ax.pcolormesh(
            grid.x_values, grid.y_values, values.T, cmap=_COLOURS[kind], norm=norm, shading="gouraud", rasterized=True
        )
        steps = norm.inverse(np.linspace(0.0, 1.0, levels + 1)[1:-1])
        lines: Any = {"colors": "white", "linewidths": 0.5, "linestyles": "solid", "alpha": 0.8}
        ax.contour(grid.x_values, grid.y_values, values.T, levels=np.unique(steps), **lines)
        _draw_runs(ax, grid)
        if detail is not None:
            ax.set(xlim=grid.x.interval, ylim=grid.y.interval)
            _draw_detail(ax, detail, np.exp(detail.values - top), lines | {"levels": np.unique(steps)})
        elif grid.truth is not None:
            mark(ax, grid.truth, RED, "ground truth", marker="o")
        ax.set(xlabel=grid.x.figure_label(), ylabel=grid.y.figure_label(), xlim=grid.x.interval, ylim=grid.y.interval)
        if colour_bar:
            extend = "min" if float(values.min()) < float(norm.vmin or 0.0) else "neither"
            bar = figure_of(ax).colorbar(drawn, ax=ax, label=_LABELS[kind], extend=extend)
            if isinstance(norm, FuncNorm):
                places, labels = root_ticks(norm.inverse(0.0), norm.inverse(1.0))
                bar.set_ticks(places, labels=labels)
        if legend:
            below(ax)
    return ax


def three_measures(
    fields: Mapping[str, FieldGrid],
    *,
    kind: Kind = "likelihood",
    floor: float | None = None,
    figure: Figure | SubFigure | None = None,
) -> Figure | SubFigure:
    """Draw fields side by side, titled by their keys: (a), (b), (c).

    Normalised likelihoods share one colour bar; other fields have one each, since discrepancies differ in scale.
    """
    shared = kind == "likelihood"
    with styled():
        figure = figure_or_new(figure, (SINGLE if len(fields) == 1 else DOUBLE, 2.9 if len(fields) < 3 else 2.4))
        panels = figure.subplots(1, len(fields), sharey=True, squeeze=False)[0]
        for letter, ax, (title, grid) in zip("abcdefgh", panels, fields.items(), strict=False):
            plot_field(grid, kind=kind, floor=floor, colour_bar=not shared, legend=False, ax=ax)
            ax.set_title(f"({letter}) {title}" if len(fields) > 1 else title)
            ax.label_outer()
        _keep_last_label(figure, list(panels))
        if shared:
            figure.colorbar(panels[0].collections[0], ax=list(panels), label=_LABELS[kind], pad=0.01)
        handles, labels = panels[0].get_legend_handles_labels()
        legend_under(figure, dict(zip(labels, handles, strict=True)))
    return figure


def plot_profile(
    x: Parameter,
    x_values: Float[np.ndarray, " x"],
    values: Float[np.ndarray, " x"],
    *,
    sd: Float[np.ndarray, " x"] | None = None,
    failed: Float[np.ndarray, " run"] | None = None,
    truth: float | None = None,
    label: str = "log-likelihood",
    ax: Axes | None = None,
) -> Axes:
    """Draw a scalar over a single input, with a band of two standard deviations and the failed runs at its foot."""
    with styled():
        ax = axes_or_new(ax)
        ax.plot(x_values, values, color=BLACK)
        if sd is not None:
            ax.fill_between(x_values, values - 2 * sd, values + 2 * sd, color=GREY, alpha=0.4, label="± 2 sd")
        if failed is not None and len(failed):
            foot = np.full(len(failed), ax.get_ylim()[0])
            ax.plot(failed, foot, "x", color=GREY, label="failed run", clip_on=False)
        if truth is not None:
            ax.axvline(truth, color=RED, linestyle=":", label="ground truth")
        ax.set(xlabel=x.figure_label(), ylabel=label, xlim=x.interval)
        if ax.get_legend_handles_labels()[0]:
            ax.legend()
    return ax


def _norm(values: Float[np.ndarray, "x y"], kind: Kind, floor: float | None) -> Normalize:
    """Return the map from values to colours."""
    top = float(values.max())
    if kind == "likelihood":
        return Normalize(0.0, 1.0)
    if kind == "sd":
        return Normalize(0.0, top or 1.0)
    low = float(values.min()) if floor is None else floor
    return FuncNorm(root_scale(top), vmin=min(low, top - 1e-9), vmax=top)


def _keep_last_label(figure: Figure | SubFigure, panels: Sequence[Axes]) -> None:
    """Keep only the label of the rightmost colour bar."""
    bars = [ax for ax in figure.axes if ax not in panels]
    for bar in bars[:-1]:
        bar.set_ylabel("")


def _draw_runs(ax: Axes, grid: FieldGrid) -> None:
    if grid.training is not None and len(grid.training):
        edge: Any = {"markeredgecolor": "#505050", "markeredgewidth": 0.4}
        ax.plot(*grid.training.T, ".", color="white", markersize=3.5, label="training point", **edge)
    if grid.failed is not None and len(grid.failed):
        rim: Any = [patheffects.withStroke(linewidth=2.0, foreground="#303030")]
        ax.plot(
            *grid.failed.T,
            "x",
            color="#c8c8c8",
            markersize=4.5,
            markeredgewidth=1.2,
            label="failed run",
            path_effects=rim,
        )


def _draw_detail(ax: Axes, detail: FieldGrid, values: Float[np.ndarray, "x y"], lines: Mapping[str, Any]) -> None:
    """Draw a small part of the field enlarged in the corner farthest from it, with a frame around that part."""
    inset = ax.inset_axes(_corner(ax, detail))
    colours: Any = {"cmap": _COLOURS["likelihood"], "norm": Normalize(0.0, 1.0), "shading": "gouraud"}
    inset.pcolormesh(detail.x_values, detail.y_values, values.T, rasterized=True, **colours)
    inset.contour(detail.x_values, detail.y_values, values.T, **lines)
    if detail.truth is not None:
        mark(inset, detail.truth, RED, "ground truth", marker="o", size=6.0)
        mark(ax, [np.nan, np.nan], RED, "ground truth", marker="o")  # for the legend
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
