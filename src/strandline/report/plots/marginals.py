"""Marginal of one input: weighted histogram, kernel density estimate and prior (Figs. 9 and 13)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import MaxNLocator

from strandline.errors import NumericsError
from strandline.parameters import Parameter
from strandline.posterior import KernelDensity, Posterior, histogram
from strandline.report.plots.style import (
    BLACK,
    BLUE,
    DOUBLE,
    PURPLE,
    RED,
    SINGLE,
    SKY,
    axes_or_new,
    figure_or_new,
    legend_under,
    styled,
)
from strandline.report.plots.view import shown_interval
from strandline.typeset import unit_text

__all__ = ["Curve", "plot_marginal", "plot_marginals"]


@dataclass(frozen=True, eq=False)
class Curve:
    """A density from another source to draw over a marginal, e.g. from quadrature of the same surrogate.

    Args:
        x: values of the input (point,).
        density: densities there (point,).
        label: what the legend calls it.
    """

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
        ax = axes_or_new(ax, (SINGLE, 2.6))
        shown = parameter.interval if whole_box else shown_interval(posterior, name)
        draw_marginal(ax, parameter, posterior.columns([name])[:, 0], posterior.weights, shown=shown, bins=bins)
        if overlay is not None:
            ax.plot(overlay.x, overlay.density, color=PURPLE, linestyle="-.", linewidth=1.6, label=overlay.label)
        if truth is not None:
            ax.axvline(truth, color=BLUE, linestyle=":", label="ground truth")
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
    columns = min(3 if len(chosen) <= 6 else 4, len(chosen))
    rows = -(-len(chosen) // columns)
    with styled():
        figure = figure_or_new(figure, (SINGLE if columns == 1 else DOUBLE, (2.2 if columns < 3 else 1.8) * rows + 0.5))
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for ax, name in zip(panels, chosen, strict=False):
            overlay, value = (overlays or {}).get(name), (truth or {}).get(name)
            plot_marginal(
                posterior, name, bins=bins, overlay=overlay, truth=value, legend=False, whole_box=whole_box, ax=ax
            )
        for ax in panels[len(chosen) :]:
            ax.remove()
        handles = {
            label: h for ax in panels[: len(chosen)] for h, label in zip(*ax.get_legend_handles_labels(), strict=True)
        }
        legend_under(figure, handles)
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
    ax.stairs(bars.density, bars.edges, fill=True, color=SKY, alpha=0.7, orientation=orientation, label="particles")
    grid = np.linspace(*shown, 301)
    prior = np.exp(np.asarray(parameter.truncated_prior.log_density(grid)))
    prior = np.where(np.isfinite(prior), prior, np.nan)
    try:
        estimate = KernelDensity.fit(values[:, None], weights, bounds=[parameter.interval])
        _line(ax, grid, estimate.density(grid[:, None]), upright, color=BLACK, label="KDE")
    except NumericsError:
        pass  # an input without spread has no density: its one bar shows everything
    _line(ax, grid, prior, upright, color=RED, linestyle="--", label="prior")
    along = ax.yaxis if upright else ax.xaxis
    along.set_major_locator(MaxNLocator(nbins=4))  # long labels do not run together


def density_label(parameter: Parameter) -> str:
    """Return the label of a density axis with its unit: ``density [Pa⁻¹]``."""
    unit = unit_text(parameter.unit, inverse=True).replace("$", r"\$")
    return f"density [{unit}]" if unit else "density"


def _line(
    ax: Axes, x: Float[np.ndarray, " point"], y: Float[np.ndarray, " point"], upright: bool, **style: str
) -> None:
    ax.plot(*((y, x) if upright else (x, y)), **style)  # type: ignore[arg-type]
