"""Several inputs: marginals on the diagonal, and each pair below it; parallel axes (Fig. 15); a posterior's figures."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from strandline.foundations import unfit
from strandline.parameters import Parameter
from strandline.posterior import Posterior
from strandline.report.plots import joint, style
from strandline.report.plots.random_field import plot_random_field

MASSES = (0.68, 0.95)
"""Probabilities of the two regions."""
INNER, OUTER = 0.7, 0.3
"""Opacities of the regions; the inner one is drawn over the outer one."""
MOST, GRID = 2000, 41
"""Most particles behind a region, and points of its grid along an input; with 71, a corner took twice as long."""
PANEL = 1.35
"""Width of a panel, inches."""


@style.drawn()
def plot_corner(
    posterior: Posterior, names: Sequence[str] | None = None, *, truth: Mapping[str, float] | None = None
) -> Figure:
    """Draw marginals with priors, and each pair's smallest regions that hold 68 and 95 %; `truth` may be partial.

    By default, all inputs but the coefficients of fields are drawn.
    """
    chosen = posterior.space.scalars if names is None else tuple(names)
    width = min(max(style.SINGLE, 0.5 + PANEL * len(chosen)), style.DOUBLE)
    figure = style.new_figure(width, width + 0.2)
    panels: Any = figure.subplots(len(chosen), len(chosen), squeeze=False)
    for row, column in np.ndindex(panels.shape):
        ax, left, last = panels[row, column], column == 0 and row > 0, row == len(chosen) - 1
        across, up = chosen[column], chosen[row]
        if row < column:
            ax.remove()
            continue
        if row == column:
            joint.plot_marginal(posterior, up, truth=(truth or {}).get(up), legend=False, ax=ax)
            ax.set(yticks=[])
        else:
            _regions(ax, posterior, (across, up), truth or {})
            ax.yaxis.set_major_locator(MaxNLocator(3, prune="both"))
        ax.xaxis.set_major_locator(MaxNLocator(3, prune="both"))
        ax.set_xlabel(posterior.space[across].figure_label() if last else "")
        ax.set_ylabel(posterior.space[up].figure_label() if left else "")
        ax.tick_params(labelbottom=last, labelleft=left)
    entries = style.labelled(*panels.diagonal())
    if len(chosen) > 1:
        for mass, alpha in zip(MASSES, (1 - (1 - INNER) * (1 - OUTER), OUTER), strict=True):
            entries[f"{100 * mass:g} %"] = Patch(facecolor=style.SKY, alpha=alpha, edgecolor=style.BLUE)
    style.legend_under(figure, entries)
    return figure


def _regions(ax: Axes, posterior: Posterior, pair: tuple[str, str], truth: Mapping[str, float]) -> None:
    """Draw the smallest regions of two inputs that hold 68 and 95 %; the draws themselves if they lie on a line."""
    found = joint.smoothed(posterior, pair, MASSES, MOST, GRID)
    if found is None:
        ax.plot(*posterior.columns(pair).T, ".", color=style.BLUE, markersize=2)
    else:
        *grid, levels = found
        top = max(float(grid[2].max()), float(levels[-1])) * 1.001
        for level, alpha in zip(levels.tolist(), (OUTER, INNER), strict=False):
            ax.contourf(*grid, levels=[level, top], colors=[style.SKY], alpha=alpha)
        ax.contour(*grid, levels=levels, colors=style.BLUE, linewidths=0.8)
    for name, line in zip(pair, (ax.axvline, ax.axhline), strict=True):
        if name in truth:
            line(truth[name], color=style.BLUE, linestyle=":")
    ax.set(xlim=joint.axis_limits(posterior, pair[0]), ylim=joint.axis_limits(posterior, pair[1]))


@dataclass(frozen=True, repr=False)
class PosteriorPlots:
    """Draws figures of a posterior; each method returns the axes, or the figure, that it drew in."""

    posterior: Posterior

    def __repr__(self) -> str:
        return "<plots: corner, field, joint, marginal, marginals, particles>"

    def corner(self, **options: Any) -> Any:
        """Draw all marginals and the regions with 68 and 95 % of each pair of inputs; options of `plot_corner`."""
        return plot_corner(self.posterior, **self._known(options))

    def joint(self, x: str | None = None, y: str | None = None, *, ax: Any = None, **options: Any) -> Any:
        """Draw the joint density of two inputs, by default the first two; options of `plot_hexagons`."""
        return joint.plot_hexagons(self.posterior, self._two(x, y), ax=ax, **options)

    def particles(self, x: str | None = None, y: str | None = None, *, ax: Any = None, **options: Any) -> Any:
        """Draw the weighted particles in the plane of two inputs; options of `plot_particles`."""
        return joint.plot_particles(self.posterior, self._two(x, y), ax=ax, **options)

    def marginal(self, name: str | None = None, *, ax: Any = None, **options: Any) -> Any:
        """Draw the marginal of an input, by default the first, with its prior; options of `plot_marginal`."""
        return joint.plot_marginal(self.posterior, name or self._scalars(1)[0], ax=ax, **options)

    def marginals(self, **options: Any) -> Any:
        """Draw the marginals of all inputs; options of `plot_marginals`."""
        return joint.plot_marginals(self.posterior, **self._known(options))

    def field(self, name: str | None = None, **options: Any) -> Any:
        """Draw what is known of a random field, by default the first; options of `plot_random_field`."""
        known = self.posterior.fields
        if not known or name not in (None, *known):
            expected = f"one of {', '.join(known)}" if known else "a posterior of coefficients of a field"
            raise unfit("field of the posterior", name, expected, "Correct the name.")
        return plot_random_field(known[name or next(iter(known))], **options)

    def _known(self, options: dict[str, Any]) -> dict[str, Any]:
        """Return the options; refuse a truth of inputs that the posterior does not have."""
        for name in options.get("truth") or ():
            _ = self.posterior.space[name]
        if options.get("names") is None:
            self._scalars(1)
        return options

    def _scalars(self, least: int) -> tuple[str, ...]:
        """Return the inputs that are no coefficients of a field; refuse too few of them."""
        names = self.posterior.space.scalars
        if len(names) < least:
            found = f"a posterior of {' and '.join([*names, *self.posterior.fields])} alone"
            expected, instead = ("two inputs or more", "marginal") if names else ("inputs beside its fields", "field")
            what = "joint density of two inputs" if least > 1 else "marginals"
            raise unfit(what, found, f"a posterior of {expected}", f"Draw .plot.{instead}() instead.")
        return names

    def _two(self, x: str | None, y: str | None) -> tuple[str, str]:
        names = self.posterior.space.names if x and y else self._scalars(2)
        first = x or next(name for name in names if name != y)
        return first, y or next(name for name in names if name != first)


DENSITY = "log posterior density"
"""Name of the density axis."""
LOWEST = 0.02
"""Quantile of the log density, by weight, at which its axis begins; lower particles are drawn at its lower end."""
TICKS = 5


@style.drawn(style.DOUBLE, 3.5)
def plot_parallel(posterior: Posterior, *, truth: Mapping[str, float] | None = None, ax: Axes = style.NEW) -> Axes:
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
    look = {"cmap": "turbo", "norm": norm, "linewidths": 0.35, "alpha": 0.55, "rasterized": True}
    _add_lines(ax, np.stack(heights, axis=1)[ranked], **look).set_array(density[ranked])
    labels = [DENSITY.replace(" ", "\n", 1) if name == DENSITY else space[name].figure_label() for name in order]
    _draw_axes(ax, labels, list(ends.values()))
    for name, value in (truth or {}).items():
        if name in ends:
            a, b = ends[name]
            label = "ground truth" if not ax.get_legend_handles_labels()[1] else None
            dot: Any = {"color": "white", "markeredgecolor": style.BLUE, "markeredgewidth": 2.0, "markersize": 7}
            ax.plot([order.index(name)], [(value - a) / (b - a)], "o", zorder=6, label=label, clip_on=False, **dot)
    ax.figure.colorbar(ScalarMappable(norm, "turbo"), ax=ax, label=DENSITY, extend="min", pad=0.02, aspect=30)
    if ax.get_legend_handles_labels()[0]:
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0))
    return ax


@style.drawn(style.DOUBLE, 3.2)
def plot_failed_runs(
    inputs: Sequence[Parameter],
    ok: Float[np.ndarray, "run dim"],
    failed: Mapping[str, Float[np.ndarray, "_ dim"]],
    *,
    ax: Axes = style.NEW,
) -> Axes:
    """Draw each run as a line across an axis for each input: grey if it succeeded, coloured by kind if it failed."""
    low, high = np.array([one.interval for one in inputs]).T

    def shares(x: Float[np.ndarray, "run dim"]) -> Float[np.ndarray, "run dim"]:
        return np.asarray((x - low) / (high - low))

    _add_lines(ax, shares(ok), colors=style.GREY, linewidths=0.4, alpha=0.35, label=f"ok: {len(ok)}")
    for k, (kind, points) in enumerate(failed.items()):
        colour, dashes = style.CYCLE[(k + 1) % len(style.CYCLE)], style.DASHES[k % len(style.DASHES)]
        look = {"colors": colour, "linestyles": [dashes], "linewidths": 0.9, "alpha": 0.9}
        _add_lines(ax, shares(points), label=f"{kind}: {len(points)}", **look)
    _draw_axes(ax, [one.figure_label() for one in inputs], [one.interval for one in inputs])
    style.below(ax)
    return ax


def _order(posterior: Posterior) -> tuple[str, ...]:
    nuisance = tuple(p.name for p in posterior.space if p.nuisance)
    return (*(name for name in posterior.space.scalars if name not in nuisance), DENSITY, *nuisance)


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
