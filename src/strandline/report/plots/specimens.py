"""Many specimens: their intervals side by side, and the density of the population that they come from."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes

from strandline.report.plots.style import BLUE, DOUBLE, GREY, RED, SINGLE, SKY, axes_or_new, below, styled

__all__ = ["PopulationDensity", "SpecimenIntervals", "plot_caterpillar", "plot_population"]

MOST_NAMED = 60
"""Largest number of specimens whose names are written below their intervals."""
ROWS = 0.025
"""Length of the strokes that stand for specimens, as a share of the axes."""


@dataclass(frozen=True, eq=False)
class SpecimenIntervals:
    """Intervals of one input for all specimens.

    Args:
        names: Names of the specimens.
        own: Quantiles of 5, 50 and 95 % from its own outline, shape (specimen, 3).
        shrunk: The same given all specimens; None without a population.
        outlier: Whether each is an outlier, shape (specimen,).
    """

    names: Sequence[str]
    own: Float[np.ndarray, "specimen three"]
    shrunk: Float[np.ndarray, "specimen three"] | None
    outlier: Bool[np.ndarray, " specimen"]


@dataclass(frozen=True, eq=False)
class PopulationDensity:
    """Density of one input in the population.

    Args:
        x: Values of the input.
        median: Posterior median of the density, per unit of the input.
        low: Its quantile of 5 %.
        high: Its quantile of 95 %.
    """

    x: Float[np.ndarray, " place"]
    median: Float[np.ndarray, " place"]
    low: Float[np.ndarray, " place"]
    high: Float[np.ndarray, " place"]


def plot_caterpillar(found: SpecimenIntervals, label: str, *, ax: Axes | None = None) -> Axes:
    """Draw the 90 % intervals of an input for all specimens, sorted by their medians.

    Args:
        found: The intervals.
        label: Symbol of the input with its unit, for Matplotlib.
        ax: Where to draw.
    """
    with styled():
        ax = axes_or_new(ax, (DOUBLE, 2.9))
        centre = found.own if found.shrunk is None else found.shrunk
        order = np.argsort(centre[:, 1], kind="stable")
        places, many = np.arange(len(order)), len(order) > MOST_NAMED
        apart, width = (0.0, 0.6) if many else (0.15, 1.2)
        own, odd = found.own[order], found.outlier[order]
        ax.vlines(places - apart, own[:, 0], own[:, 2], color=GREY, linewidth=width, label="own outline alone")
        ax.plot(places - apart, own[:, 1], ".", color=GREY, markersize=2 if many else 4)
        if found.shrunk is not None:
            all_of_them = found.shrunk[order]
            low, high = all_of_them[:, 0], all_of_them[:, 2]
            ax.vlines(places + apart, low, high, color=BLUE, linewidth=width, label="given all specimens")
            ax.plot(places + apart, all_of_them[:, 1], ".", color=BLUE, markersize=2 if many else 4)
        if odd.any():
            ax.plot(places[odd], own[odd, 1], "o", color=RED, fillstyle="none", markersize=7, label="outlier")
        if many:
            ax.set(xlabel="specimens, sorted", xticks=[])
        else:
            ax.set_xticks(places, [found.names[i] for i in order], rotation=90, fontsize=6)
        ax.set(ylabel=label, xlim=(-1, len(order)))
        ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3)  # above: names of any length stand below
    return ax


def plot_population(
    density: PopulationDensity, specimens: Float[np.ndarray, " specimen"], label: str, *, ax: Axes | None = None
) -> Axes:
    """Draw the density of an input in the population, above a stroke for the mean of each specimen.

    Args:
        density: The density.
        specimens: Posterior mean of each specimen given all of them, shape (specimen,).
        label: Symbol of the input with its unit, for Matplotlib.
        ax: Where to draw.
    """
    with styled():
        ax = axes_or_new(ax, (SINGLE, 2.7))
        ax.fill_between(density.x, density.low, density.high, color=SKY, alpha=0.6, linewidth=0, label="90 % band")
        ax.plot(density.x, density.median, color=BLUE, label="population")
        top = float(density.high.max())
        ax.vlines(specimens, -2 * ROWS * top, -ROWS * top, color=GREY, linewidth=0.6, label="specimens")
        some = density.high > 1e-3 * top
        ends = np.concatenate([density.x[some], specimens])
        ax.set(xlabel=label, ylabel="density", xlim=(ends.min(), ends.max()))
        below(ax)
    return ax
