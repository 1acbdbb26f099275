"""Parallel axes, one for each input: all particles with their posterior density (Fig. 15), and where runs failed."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.ticker import MaxNLocator

from strandline.parameters import ParameterSpace
from strandline.posterior import Posterior
from strandline.report.plots import style
from strandline.report.plots.style import axes_or_new, below, figure_of, styled

DENSITY = "log posterior density"
"""Name of the density axis."""
LOWEST = 0.02
"""Quantile of the log density, by weight, at which its axis begins; lower particles are drawn at its lower end."""
TICKS = 5


def plot_parallel(posterior: Posterior, *, truth: Mapping[str, float] | None = None, ax: Axes | None = None) -> Axes:
    """Draw each particle as a line over parallel axes, coloured by its extended log posterior density.

    Lines of low density are drawn first and those of high density on top of them. Particles without weight are left
    out; the density, not the weight, colours the others. The axes of the inputs span their boxes: the calibrated
    inputs, the density, and the nuisance inputs last, as in the study. A point on each axis marks the ground truth.
    """
    space, density, order = posterior.space, posterior.log_density, _order(posterior)
    low = float(np.quantile(density, LOWEST, weights=posterior.weights, method="inverted_cdf"))
    high = float(density.max())
    limits = (low, high) if low < high else (low - 1.0, high)
    ends = {name: limits if name == DENSITY else space[name].interval for name in order}
    columns = [density if name == DENSITY else posterior.columns([name])[:, 0] for name in order]
    heights = [np.clip((x - a) / (b - a), 0.0, 1.0) for x, (a, b) in zip(columns, ends.values(), strict=True)]
    kept = np.flatnonzero(posterior.weights > 0)
    ranked = kept[np.argsort(density[kept], kind="stable")]
    norm = Normalize(*limits)
    with styled():
        ax = axes_or_new(ax, (style.DOUBLE, 3.5))
        look = {"cmap": "turbo", "norm": norm, "linewidths": 0.35, "alpha": 0.55, "rasterized": True}
        _add_lines(ax, np.stack(heights, axis=1)[ranked], **look).set_array(density[ranked])
        labels = [DENSITY.replace(" ", "\n", 1) if name == DENSITY else space[name].figure_label() for name in order]
        _draw_axes(ax, labels, list(ends.values()))
        for name, value in (truth or {}).items():
            if name in ends:
                a, b = ends[name]
                label = "ground truth" if not ax.get_legend_handles_labels()[1] else None
                ax.plot(
                    [order.index(name)], [(value - a) / (b - a)], "o", color="white", markeredgecolor=style.BLUE,
                    markeredgewidth=2.0, markersize=7, zorder=6, label=label, clip_on=False,
                )  # fmt: skip
        figure_of(ax).colorbar(ScalarMappable(norm, "turbo"), ax=ax, label=DENSITY, extend="min", pad=0.02, aspect=30)
        if ax.get_legend_handles_labels()[0]:
            ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0))
    return ax


def plot_failed_runs(
    space: ParameterSpace,
    ok: Float[np.ndarray, "run dim"],
    failed: Mapping[str, Float[np.ndarray, "_ dim"]],
    *,
    ax: Axes | None = None,
) -> Axes:
    """Draw each run as a line across one axis per input: grey if it succeeded, coloured by kind if it failed.

    Each axis spans the box; the commonest kind comes first.
    """
    with styled():
        ax = axes_or_new(ax, (style.DOUBLE, 3.2))
        _add_lines(ax, space.to_unit(ok), colors=style.GREY, linewidths=0.4, alpha=0.35, label=f"ok: {len(ok)}")
        for k, (kind, points) in enumerate(failed.items()):
            colour, dashes = style.CYCLE[(k + 1) % len(style.CYCLE)], style.DASHES[k % len(style.DASHES)]
            look = {"colors": colour, "linestyles": [dashes], "linewidths": 0.9, "alpha": 0.9}
            _add_lines(ax, space.to_unit(points), label=f"{kind}: {len(points)}", **look)
        _draw_axes(ax, [one.figure_label() for one in space], [one.interval for one in space])
        below(ax)
    return ax


def _order(posterior: Posterior) -> tuple[str, ...]:
    nuisance = tuple(p.name for p in posterior.space if p.nuisance)
    return (*(name for name in posterior.space.names if name not in nuisance), DENSITY, *nuisance)


def _add_lines(ax: Axes, heights: Float[np.ndarray, "line axis"], **look: Any) -> LineCollection:
    """Draw a line across all axes for each row of heights, 0 at the lower end of an axis and 1 at its upper end."""
    across = np.broadcast_to(np.arange(heights.shape[1], dtype=float), heights.shape)
    drawn = LineCollection(list(np.stack([across, heights], axis=-1)), **look)
    ax.add_collection(drawn)
    return drawn


def _draw_axes(ax: Axes, labels: Sequence[str], ends: Sequence[tuple[float, float]]) -> None:
    """Draw upright axes with ticks and their labels to their left, readable on top of the lines."""
    rim = [patheffects.withStroke(linewidth=2.5, foreground="white")]
    for place, (low, high) in enumerate(ends):
        ax.plot([place, place], [0.0, 1.0], color=style.BLACK, linewidth=1.1, zorder=4)
        for tick in MaxNLocator(TICKS, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high):
            if low <= tick <= high:
                height = (tick - low) / (high - low)
                ax.plot([place - 0.05, place], [height, height], color=style.BLACK, linewidth=1.1, zorder=4)
                look: Any = {"ha": "right", "va": "center", "fontsize": 7, "zorder": 5, "path_effects": rim}
                ax.text(place - 0.08, height, f"{tick:g}".replace("-", "−"), **look)
    ax.set(xlim=(-0.55, len(ends) - 0.85), ylim=(-0.02, 1.02), yticks=[])
    ax.set_xticks(np.arange(len(ends)), labels)
    ax.tick_params(axis="x", length=0, pad=6, labelsize=8)
    ax.spines[:].set_visible(False)
