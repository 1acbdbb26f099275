"""All particles over parallel axes, one for each input and one for the posterior density (Fig. 15)."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.ticker import MaxNLocator

from strandline.posterior import Posterior
from strandline.report.plots.style import (
    BLACK,
    BLUE,
    DOUBLE,
    axes_or_new,
    figure_of,
    styled,
)

__all__ = ["plot_parallel"]

DENSITY = "log posterior density"
"""Name of the density axis, also in `names`."""
LOWEST = 0.02
"""Quantile of the log density, by weight, at which its axis begins; lower particles are drawn at its lower end."""
TICKS = 5


def plot_parallel(
    posterior: Posterior,
    names: Sequence[str] | None = None,
    *,
    truth: Mapping[str, float] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw each particle as a line over parallel axes, coloured by its extended log posterior density.

    Lines of low density are drawn first and those of high density on top of them. Particles without weight are left
    out; the density, not the weight, colours the others. The axes of the inputs span their boxes.

    Args:
        posterior: The weighted draws.
        names: Inputs, from left to right; `DENSITY` is among them or else comes last. By default: the calibrated
            inputs, the density, and the nuisance inputs last, as in the study.
        truth: The ground truth by name, drawn as a point on each axis.
        ax: Axes to draw in.
    """
    order = _order(posterior) if names is None else tuple(names)
    order = order if DENSITY in order else (*order, DENSITY)
    density, limits = _density(posterior)
    lines = _lines(posterior, order, density, limits)
    with styled():
        ax = axes_or_new(ax, (DOUBLE, 3.5))
        norm = Normalize(*limits)
        across = np.arange(len(order), dtype=float)
        kept = np.flatnonzero(posterior.weights > 0)
        ranked = kept[np.argsort(density[kept], kind="stable")]
        segments = np.stack([np.broadcast_to(across, lines.shape), lines], axis=-1)[ranked]
        drawn = LineCollection(list(segments), cmap="turbo", norm=norm, linewidths=0.35, alpha=0.55, rasterized=True)
        drawn.set_array(density[ranked])
        ax.add_collection(drawn)
        for place, name in enumerate(order):
            draw_axis(ax, place, *(limits if name == DENSITY else posterior.space[name].interval))
            if truth is not None and name in truth:
                low, high = posterior.space[name].interval
                label = "ground truth" if not ax.get_legend_handles_labels()[1] else None
                ax.plot(
                    [place], [(truth[name] - low) / (high - low)], "o", color="white", markeredgecolor=BLUE,
                    markeredgewidth=2.0, markersize=7, zorder=6, label=label, clip_on=False,
                )  # fmt: skip
        ax.set(xlim=(-0.55, len(order) - 0.85), ylim=(-0.02, 1.02), yticks=[])
        labels = [DENSITY.replace(" ", "\n", 1) if n == DENSITY else posterior.space[n].figure_label() for n in order]
        ax.set_xticks(across, labels)
        ax.tick_params(axis="x", length=0, pad=6, labelsize=8)
        ax.spines[:].set_visible(False)
        figure_of(ax).colorbar(ScalarMappable(norm, "turbo"), ax=ax, label=DENSITY, extend="min", pad=0.02, aspect=30)
        if ax.get_legend_handles_labels()[0]:
            ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0))
    return ax


def _order(posterior: Posterior) -> tuple[str, ...]:
    """Return the calibrated inputs, the density, the nuisance inputs."""
    nuisance = tuple(p.name for p in posterior.space if p.nuisance)
    return (*(name for name in posterior.space.names if name not in nuisance), DENSITY, *nuisance)


def _density(posterior: Posterior) -> tuple[Float[np.ndarray, " particle"], tuple[float, float]]:
    """Return the log density of the particles and the limits of its axis."""
    density = posterior.log_density
    low = float(np.quantile(density, LOWEST, weights=posterior.weights, method="inverted_cdf"))
    high = float(density.max())
    return density, (low, high) if low < high else (low - 1.0, high)


def _lines(
    posterior: Posterior,
    order: Sequence[str],
    density: Float[np.ndarray, " particle"],
    limits: tuple[float, float],
) -> Float[np.ndarray, "particle axis"]:
    """Return the height of each particle on each axis, 0 at its lower end and 1 at its upper end."""
    columns = []
    for name in order:
        values = density if name == DENSITY else posterior.columns([name])[:, 0]
        low, high = limits if name == DENSITY else posterior.space[name].interval
        columns.append(np.clip((values - low) / (high - low), 0.0, 1.0))
    return np.stack(columns, axis=1)


def draw_axis(ax: Axes, place: int, low: float, high: float) -> None:
    """Draw one upright axis with ticks and their labels to its left, readable on top of the lines."""
    rim = [patheffects.withStroke(linewidth=2.5, foreground="white")]
    ax.plot([place, place], [0.0, 1.0], color=BLACK, linewidth=1.1, zorder=4)
    ticks = [t for t in MaxNLocator(TICKS, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high) if low <= t <= high]
    for tick in ticks:
        height = (tick - low) / (high - low)
        ax.plot([place - 0.05, place], [height, height], color=BLACK, linewidth=1.1, zorder=4)
        label = f"{tick:g}".replace("-", "−")
        ax.text(place - 0.08, height, label, ha="right", va="center", fontsize=7, zorder=5, path_effects=rim)
