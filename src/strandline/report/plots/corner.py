"""A corner plot: marginals on the diagonal, below it the regions that hold 68 and 95 % of each pair of inputs."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from strandline.errors import InvalidInput, NumericsError
from strandline.posterior import KernelDensity, Posterior
from strandline.report.plots.joint import thinned
from strandline.report.plots.style import BLACK, BLUE, GREY, RED, SINGLE, figure_or_new, legend_under, styled
from strandline.report.plots.view import shown_interval

__all__ = ["plot_corner"]

MASSES = (0.68, 0.95)
"""Probabilities of the two regions."""
GRID, PARTICLES, JUDGED = 61, 2000, 400
"""Grid points along an input, draws behind a region, and draws that its bandwidth is judged by."""
PANEL = 1.35
"""Width of a panel, inches."""


def plot_corner(
    posterior: Posterior,
    names: Sequence[str] | None = None,
    *,
    masses: Sequence[float] = MASSES,
    prior: bool = True,
    truth: Mapping[str, float] | None = None,
    figure: Figure | SubFigure | None = None,
) -> Figure | SubFigure:
    """Draw the marginal density of each input, and for each pair the smallest regions that hold some probabilities.

    Args:
        posterior: Weighted draws.
        names: Inputs to draw, by default all.
        masses: Probabilities of the regions, as fractions; the first is the darkest.
        prior: Whether to draw the prior of each input.
        truth: True values of some inputs.
        figure: Figure to draw in.

    Raises:
        InvalidInput: A probability that is not between 0 and 1, or not at least one of them.
    """
    levels = sorted(masses)
    if not levels or not 0 < levels[0] <= levels[-1] < 1:
        raise InvalidInput(
            "probabilities of the regions", value=masses, expected="numbers between 0 and 1", remedy="Use (0.68, 0.95)."
        )
    chosen = posterior.space.names if names is None else tuple(names)
    count = len(chosen)
    with styled():
        width = max(SINGLE, 0.5 + PANEL * count)
        figure = figure_or_new(figure, (width, width + 0.2))
        panels: Any = figure.subplots(count, count, squeeze=False)
        for row, column in np.ndindex(count, count):
            ax = panels[row, column]
            if row < column:
                ax.remove()
                continue
            if row == column:
                _marginal(ax, posterior, chosen[row], prior=prior, truth=truth)
            else:
                _regions(ax, posterior, (chosen[column], chosen[row]), levels, truth)
            _label(ax, posterior, chosen, row, column)
        handles, labels = panels[0, 0].get_legend_handles_labels()
        entries = dict(zip(labels, handles, strict=True))
        if count > 1:
            entries |= {f"{100 * mass:.3g} %": _patch(k, len(levels)) for k, mass in enumerate(levels)}
        legend_under(figure, entries)
    return figure


def _marginal(ax: Axes, posterior: Posterior, name: str, *, prior: bool, truth: Mapping[str, float] | None) -> None:
    """Draw the density of one input."""
    parameter, values = posterior.space[name], posterior.columns([name])
    shown = shown_interval(posterior, name)
    grid = np.linspace(*shown, 301)
    try:
        estimate = KernelDensity.fit(values, posterior.weights, bounds=[parameter.interval])
        density = estimate.density(grid[:, None])
        ax.plot(grid, density, color=BLACK, label="posterior")
        ax.fill_between(grid, density, color=BLUE, alpha=0.15, linewidth=0)
    except NumericsError:
        ax.axvline(float(values[0, 0]), color=BLACK, label="posterior")
    if prior:
        before = np.exp(np.asarray(parameter.truncated_prior.log_density(grid)))
        ax.plot(grid, np.where(np.isfinite(before), before, np.nan), color=GREY, linestyle="--", label="prior")
    if truth is not None and name in truth:
        ax.axvline(truth[name], color=RED, linewidth=1.0, label="truth")
    ax.set(xlim=shown, ylim=(0.0, None), yticks=[])
    ax.spines["left"].set_visible(False)


def _regions(
    ax: Axes, posterior: Posterior, pair: tuple[str, str], levels: Sequence[float], truth: Mapping[str, float] | None
) -> None:
    """Draw the smallest regions of two inputs that hold these probabilities."""
    across, up = (shown_interval(posterior, name) for name in pair)
    draws, weights = thinned(posterior.columns(pair), posterior.weights, PARTICLES)
    bounds = [posterior.space[name].interval for name in pair]
    try:
        estimate = KernelDensity.fit(draws, weights, bounds=bounds, loo_points=JUDGED)
    except NumericsError:
        ax.plot(*draws.T, ".", color=BLUE, markersize=2)
    else:
        x, y = np.linspace(*across, GRID), np.linspace(*up, GRID)
        points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        density = estimate.density(points).reshape(GRID, GRID)
        edges = sorted({float(one) for one in estimate.percentile_levels(levels)})
        top = max(float(density.max()), edges[-1]) * 1.001
        for k, edge in enumerate(edges):
            ax.contourf(x, y, density, levels=[edge, top], colors=[BLUE], alpha=_alpha(len(edges) - 1 - k, len(edges)))
        ax.contour(x, y, density, levels=edges, colors=BLUE, linewidths=0.8)
    if truth is not None:
        lines = ((pair[0], ax.axvline), (pair[1], ax.axhline))
        for name, line in lines:
            if name in truth:
                line(truth[name], color=RED, linewidth=1.0)
    ax.set(xlim=across, ylim=up)


def _alpha(place: int, count: int) -> float:
    """Return the opacity of a region, the inner ones last: drawn over each other they darken."""
    return 0.2 + 0.3 * (count - 1 - place) / max(count - 1, 1)


def _patch(place: int, count: int) -> Patch:
    """Return a patch for the legend in the colour that a region has in the figure."""
    opacity = 1.0
    for k in range(place, count):
        opacity *= 1.0 - _alpha(k, count)
    return Patch(facecolor=BLUE, alpha=1.0 - opacity, edgecolor=BLUE)


def _label(ax: Axes, posterior: Posterior, names: Sequence[str], row: int, column: int) -> None:
    """Name the inputs at the left and at the bottom only, with few numbers."""
    last = row == len(names) - 1
    ax.xaxis.set_major_locator(MaxNLocator(3, prune="both"))
    ax.tick_params(labelbottom=last, labelleft=column == 0 and row > 0)
    if last:
        ax.set_xlabel(posterior.space[names[column]].figure_label())
    if row != column:
        ax.yaxis.set_major_locator(MaxNLocator(3, prune="both"))
        if column == 0:
            ax.set_ylabel(posterior.space[names[row]].figure_label())
