"""Joint marginal of two inputs with all that the study draws into it (Figs. 9, 14), particles, marginals (9, 13)."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from strandline.foundations import NumericsError, unit_text
from strandline.parameters import Parameter
from strandline.posterior import (
    GaussianApproximation,
    Histogram,
    KernelDensity,
    LaplaceApproximation,
    Posterior,
    enclosing_levels,
    histogram,
    histogram_mode,
    systematic_indices,
)
from strandline.report.plots import style

PERCENTILES = (0.1, 0.5, 0.9)
GRID, MOST = 71, 5000
"""Points of the grid along an input on which lines are computed, and most particles that these follow from."""
NEGLIGIBLE = 1e-3
"""Hexagons with less than this share of the fullest one's mass are left out."""


@style.drawn()
def plot_joint(
    posterior: Posterior,
    names: tuple[str, str],
    *,
    laplace: LaplaceApproximation | None = None,
    truth: Mapping[str, float] | None = None,
    percentiles: Sequence[float] = PERCENTILES,
    bins: int = 30,
) -> Figure:
    """Draw hexagons of weight, percentile lines of three approximations, point estimates, marginals and priors.

    The Laplace approximation is that of all inputs of the posterior; an indefinite one is noted, not drawn. The MAP is
    the best particle if the two inputs are all there are, else the centre of the fullest bin (paper, Remark 8).
    `percentiles` are the probabilities that the lines enclose, as fractions; `bins` count hexagons across, and bins of
    the marginals.
    """
    figure = style.new_figure(style.DOUBLE, 6.2)
    x, y = (posterior.space[name] for name in names)
    pair = (posterior.space.names.index(names[0]), posterior.space.names.index(names[1]))
    values, mean = posterior.columns(names), posterior.mean
    main, top, right = _layout(figure)

    def ellipses(gaussian: GaussianApproximation, colour: str, label: str) -> None:
        look: Any = {"color": colour, "linewidth": 1.2, "label": label, "scalex": False, "scaley": False}
        for p in percentiles:
            main.plot(*gaussian.ellipse(p, pair=pair).T, **look)

    plot_hexagons(posterior, names, percentiles=percentiles, bins=bins, colour_bar=False, ax=main)
    ellipses(GaussianApproximation(mean, posterior.covariance), style.ORANGE, "Gaussian")
    style.mark(main, mean[list(pair)], style.ORANGE, "mean")
    if laplace is not None and laplace.definite:
        ellipses(laplace.gaussian, style.GREEN, "Laplace")
    if posterior.space.dim == 2:
        style.mark(main, posterior.map_estimate[list(pair)], style.GREEN, "MAP")
    else:
        mode = histogram_mode(values, posterior.weights, bounds=[x.interval, y.interval])
        style.mark(main, mode, style.GREEN, "MAP (fullest bin)")
    if truth is not None and all(name in truth for name in names):
        style.mark(main, [truth[name] for name in names], style.BLUE, "ground truth", marker="o", size=11.0)
    across, up = (axis_limits(posterior, name) for name in names)
    draw_marginal(top, x, values[:, 0], posterior.weights, shown=across, bins=bins)
    draw_marginal(right, y, values[:, 1], posterior.weights, shown=up, bins=bins, upright=True)
    figure.colorbar(main.collections[0], ax=right, label="probability of a hexagon", location="right", shrink=0.9)
    note = "" if laplace is None or laplace.definite else "Laplace: none, Hessian indefinite"
    _legend(figure, main, top, percentiles, note)
    return figure


@style.drawn(style.SINGLE, 2.8)
def plot_hexagons(
    posterior: Posterior,
    names: tuple[str, str],
    *,
    percentiles: Sequence[float] = PERCENTILES,
    bins: int = 30,
    colour_bar: bool = True,
    ax: Axes = style.NEW,
) -> Axes:
    """Draw the weighted hexagonal histogram of two inputs with percentile lines of a kernel density estimate.

    `percentiles` are the probabilities that the lines enclose, as fractions. There are `bins` hexagons across.
    """
    x, y = (posterior.space[name] for name in names)
    across, up = (axis_limits(posterior, name) for name in names)
    sums: Any = {"C": posterior.weights, "reduce_C_function": np.sum, "extent": (*across, *up)}
    drawn = ax.hexbin(*posterior.columns(names).T, gridsize=bins, cmap="Blues", linewidths=0.1, **sums)
    mass: Any = drawn.get_array()
    drawn.set_array(np.ma.masked_less(mass, NEGLIGIBLE * mass.max()))
    drawn.set_clim(vmin=0.0)
    if (found := smoothed(posterior, names, percentiles, MOST, GRID)) is not None:
        *grid, levels = found
        ax.contour(*grid, levels=levels, colors=style.BLACK, linewidths=1.2)
    ax.set(xlabel=x.figure_label(), ylabel=y.figure_label(), xlim=across, ylim=up)
    if colour_bar:
        ax.figure.colorbar(drawn, ax=ax, label="probability of a hexagon")
    return ax


def _layout(figure: Figure) -> tuple[Axes, Axes, Axes]:
    """Return the axes in the middle, above and to the right."""
    grid = figure.add_gridspec(2, 2, width_ratios=(4, 1.1), height_ratios=(1.1, 4))
    main = figure.add_subplot(grid[1, 0])
    top, right = figure.add_subplot(grid[0, 0], sharex=main), figure.add_subplot(grid[1, 1], sharey=main)
    top.tick_params(labelbottom=False, labelleft=False, left=False)
    right.tick_params(labelleft=False, labelbottom=False, bottom=False)
    top.set_ylabel("density")
    right.set_xlabel("density")
    return main, top, right


Smoothed = tuple[Float[np.ndarray, " x"], Float[np.ndarray, " y"], Float[np.ndarray, "y x"], Float[np.ndarray, " n"]]


def smoothed(
    posterior: Posterior, names: tuple[str, str], masses: Sequence[float], most: int, number: int
) -> Smoothed | None:
    """Return a grid of `number` points along either of two inputs over the parts that are shown, a kernel density
    estimate on it, and its levels, ascending, whose contours enclose these probabilities; None for draws on a line,
    which have no density in the plane.

    More than `most` particles are thinned by systematic resampling, and a fifth of them judge the bandwidth.
    """
    draws, weights = posterior.columns(names), posterior.weights
    if len(draws) > most:
        draws = draws[systematic_indices(weights, most, np.random.default_rng(0))]
        weights = np.full(most, 1.0 / most)
    bounds = [posterior.space[name].interval for name in names]
    try:
        estimate = KernelDensity.fit(draws, weights, bounds=bounds, loo_points=most // 5)
    except NumericsError:
        return None
    x, y = (np.linspace(*axis_limits(posterior, name), number) for name in names)
    density = estimate.density(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)).reshape(number, number)
    return x, y, density, np.unique(enclosing_levels(density, masses))


def _legend(figure: Figure, main: Axes, top: Axes, percentiles: Sequence[float], note: str) -> None:
    entries: dict[str, Any] = {f"KDE {style.percent(percentiles)}": Line2D([], [], color=style.BLACK)}
    for label, handle in style.labelled(main).items():
        entries[f"{label} {style.percent(percentiles)}" if label in ("Gaussian", "Laplace") else label] = handle
    entries["prior"] = style.labelled(top)["prior"]
    if note:
        entries[note] = Line2D([], [], color="none")
    style.legend_under(figure, entries)


@style.drawn(style.SINGLE, 2.8)
def plot_particles(
    posterior: Posterior, names: tuple[str, str], *, largest: float = 16.0, ax: Axes = style.NEW
) -> Axes:
    """Draw particles over two inputs; areas of circles, points², go with the weights, `largest` for the heaviest."""
    order = np.argsort(posterior.weights)
    weights, points = posterior.weights[order], posterior.columns(names)[order]
    x, y = posterior.space[names[0]], posterior.space[names[1]]
    across, up = (axis_limits(posterior, name) for name in names)
    area = largest * weights / weights.max()
    drawn = ax.scatter(points[:, 0], points[:, 1], s=area, c=weights, cmap="viridis_r", vmin=0.0, rasterized=True)
    drawn.set(edgecolors="white", linewidths=0.15)
    ax.set(xlabel=x.figure_label(), ylabel=y.figure_label(), xlim=across, ylim=up)
    ax.figure.colorbar(drawn, ax=ax, label="weight of the particle")
    return ax


TAIL, MARGIN = 0.002, 0.35
"""Share of the mass left out at either end of an axis, and the space added there, as a share of what is shown."""
WHOLE_BOX_FROM = 0.75
"""Share of the box from which all of it is shown."""


@style.drawn(style.SINGLE, 2.6)
def plot_marginal(
    posterior: Posterior,
    name: str,
    *,
    bins: int = 30,
    exact: Histogram | None = None,
    truth: float | None = None,
    legend: bool = True,
    whole_box: bool = False,
    ax: Axes = style.NEW,
) -> Axes:
    """Draw the marginal of an input, its prior, that by quadrature; with `whole_box`, all of the prior (Fig. 10)."""
    parameter = posterior.space[name]
    shown = parameter.interval if whole_box else axis_limits(posterior, name)
    draw_marginal(ax, parameter, posterior.columns([name])[:, 0], posterior.weights, shown=shown, bins=bins)
    if exact is not None:
        middles = 0.5 * (exact.edges[1:] + exact.edges[:-1])
        ax.plot(middles, exact.density, color=style.PURPLE, linestyle="-.", linewidth=1.6, label="quadrature")
    if truth is not None:
        ax.axvline(truth, color=style.BLUE, linestyle=":", label="ground truth")
    unit = unit_text(parameter.unit, inverse=True).replace("$", r"\$")
    ax.set(xlabel=parameter.figure_label(), ylabel=f"density [{unit}]" if unit else "density", xlim=shown)
    if legend:
        ax.legend()
    return ax


@style.drawn()
def plot_marginals(
    posterior: Posterior,
    names: Sequence[str] | None = None,
    *,
    bins: int = 30,
    exact: Mapping[str, Histogram] | None = None,
    truth: Mapping[str, float] | None = None,
    whole_box: bool = False,
) -> Figure:
    """Draw the marginals of several inputs, three or four in a row; by default of all but coefficients of fields."""
    chosen = posterior.space.scalars if names is None else tuple(names)
    height, columns = 2.2 if len(chosen) < 3 else 1.8, 3 if len(chosen) <= 6 else 4
    figure, panels = style.panel_grid(len(chosen), height, columns=columns)
    for ax, name in zip(panels, chosen, strict=True):
        own: Any = {"exact": (exact or {}).get(name), "truth": (truth or {}).get(name)}
        plot_marginal(posterior, name, bins=bins, **own, legend=False, whole_box=whole_box, ax=ax)
    style.legend_under(figure, style.labelled(*panels))
    return figure


def draw_marginal(
    ax: Axes,
    parameter: Parameter,
    values: Float[np.ndarray, " particle"],
    weights: Float[np.ndarray, " particle"],
    *,
    shown: tuple[float, float],
    bins: int = 30,
    upright: bool = False,
) -> None:
    """Draw histogram, kernel density estimate and prior of one input; `upright` puts the input on the y axis."""
    inside = (values >= shown[0]) & (values <= shown[1])
    bars = histogram(values[inside], weights[inside], bounds=shown, bins=bins)
    look: Any = {"color": style.SKY, "alpha": 0.7, "orientation": "horizontal" if upright else "vertical"}
    ax.stairs(bars.density, bars.edges, fill=True, label="particles", **look)
    grid = np.linspace(*shown, 301)
    prior = np.exp(np.asarray(parameter.truncated_prior.log_density(grid)))
    prior = np.where(np.isfinite(prior), prior, np.nan)
    try:
        estimate = KernelDensity.fit(values[:, None], weights, bounds=[parameter.interval], loo_points=MOST // 10)
        _line(ax, grid, estimate.density(grid[:, None]), upright, color=style.BLACK, label="KDE")
    except NumericsError:
        pass  # an input without spread has no density: its one bar shows everything
    _line(ax, grid, prior, upright, color=style.RED, linestyle="--", label="prior")
    along = ax.yaxis if upright else ax.xaxis
    along.set_major_locator(MaxNLocator(nbins=4))  # long labels do not run together


def _line(ax: Axes, x: Float[np.ndarray, " point"], y: Float[np.ndarray, " point"], upright: bool, **look: str) -> None:
    ax.plot(*((y, x) if upright else (x, y)), **look)  # type: ignore[arg-type]


def axis_limits(posterior: Posterior, name: str) -> tuple[float, float]:
    """Return the part of the design box that holds nearly all mass, with a margin; the box if that is most of it.

    A posterior that data have narrowed to a few per cent of the box would be a speck on axes that show the whole box.
    """
    box = posterior.space[name].interval
    index = posterior.space.names.index(name)
    first, last = (float(q) for q in posterior.quantiles([TAIL, 1.0 - TAIL])[:, index])
    margin = MARGIN * (last - first)
    low, high = max(box[0], first - margin), min(box[1], last + margin)
    narrow = low < high and high - low < WHOLE_BOX_FROM * (box[1] - box[0])
    return (low, high) if narrow else box
