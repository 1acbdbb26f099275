"""Marginal of one input: weighted histogram, kernel density estimate and prior (Figs. 9 and 13)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import MaxNLocator

from strandline.errors import NumericsError
from strandline.parameters import Parameter
from strandline.posterior import KernelDensity, Posterior, histogram
from strandline.report.plots import style
from strandline.report.plots.style import axes_or_new, labelled, legend_under, panel_grid, styled
from strandline.typeset import unit_text

TAIL, MARGIN = 0.002, 0.35
"""Share of the mass left out at either end of an axis, and the space added there, as a share of what is shown."""
WHOLE_BOX_FROM = 0.75
"""Share of the box from which all of it is shown."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A density from another source to draw over a marginal, e.g. from quadrature of the same surrogate."""

    x: Float[np.ndarray, " point"]
    density: Float[np.ndarray, " point"]
    label: str = "quadrature"


def plot_marginal(
    posterior: Posterior,
    name: str,
    *,
    bins: int = 30,
    overlay: Curve | None = None,
    truth: float | None = None,
    legend: bool = True,
    whole_box: bool = False,
    ax: Axes | None = None,
) -> Axes:
    """Draw the marginal posterior of one input with its prior; `whole_box` shows all of the prior (Fig. 10)."""
    parameter = posterior.space[name]
    with styled():
        ax = axes_or_new(ax, (style.SINGLE, 2.6))
        shown = parameter.interval if whole_box else axis_limits(posterior, name)
        draw_marginal(ax, parameter, posterior.columns([name])[:, 0], posterior.weights, shown=shown, bins=bins)
        if overlay is not None:
            ax.plot(overlay.x, overlay.density, color=style.PURPLE, linestyle="-.", linewidth=1.6, label=overlay.label)
        if truth is not None:
            ax.axvline(truth, color=style.BLUE, linestyle=":", label="ground truth")
        ax.set(xlabel=parameter.figure_label(), ylabel=density_label(parameter), xlim=shown)
        if legend:
            ax.legend()
    return ax


def plot_marginals(
    posterior: Posterior,
    names: Sequence[str] | None = None,
    *,
    bins: int = 30,
    overlays: Mapping[str, Curve] | None = None,
    truth: Mapping[str, float] | None = None,
    whole_box: bool = False,
    figure: Figure | SubFigure | None = None,
) -> Figure | SubFigure:
    """Draw the marginals of several inputs (by default of all of them), three or four in a row."""
    chosen = posterior.space.names if names is None else tuple(names)
    height, columns = 2.2 if len(chosen) < 3 else 1.8, 3 if len(chosen) <= 6 else 4
    with styled():
        figure, panels = panel_grid(figure, len(chosen), height, columns=columns)
        for ax, name in zip(panels, chosen, strict=True):
            own: Any = {"overlay": (overlays or {}).get(name), "truth": (truth or {}).get(name)}
            plot_marginal(posterior, name, bins=bins, **own, legend=False, whole_box=whole_box, ax=ax)
        legend_under(figure, labelled(*panels))
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
    orientation: Literal["horizontal", "vertical"] = "horizontal" if upright else "vertical"
    ax.stairs(
        bars.density, bars.edges, fill=True, color=style.SKY, alpha=0.7, orientation=orientation, label="particles"
    )
    grid = np.linspace(*shown, 301)
    prior = np.exp(np.asarray(parameter.truncated_prior.log_density(grid)))
    prior = np.where(np.isfinite(prior), prior, np.nan)
    try:
        estimate = KernelDensity.fit(values[:, None], weights, bounds=[parameter.interval])
        _line(ax, grid, estimate.density(grid[:, None]), upright, color=style.BLACK, label="KDE")
    except NumericsError:
        pass  # an input without spread has no density: its one bar shows everything
    _line(ax, grid, prior, upright, color=style.RED, linestyle="--", label="prior")
    along = ax.yaxis if upright else ax.xaxis
    along.set_major_locator(MaxNLocator(nbins=4))  # long labels do not run together


def density_label(parameter: Parameter) -> str:
    """Return the label of a density axis with its unit: ``density [Pa⁻¹]``."""
    unit = unit_text(parameter.unit, inverse=True).replace("$", r"\$")
    return f"density [{unit}]" if unit else "density"


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
