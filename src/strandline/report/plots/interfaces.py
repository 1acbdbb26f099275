"""Interfaces: observed, undeformed and simulated ones (Fig. 4), offsets, residuals; the flow behind them (Fig. 3)."""

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation

from strandline.foundations import unfit
from strandline.interface import Interface
from strandline.posterior import Offsets
from strandline.report.plots import style

_HALF_LINE = 38
"""Characters of a label that leave room for a second one next to it."""
_FLAT = 0.3
"""Least height of the drawn interfaces, relative to their width; flatter ones are stretched."""


@style.drawn()
def plot_interfaces(
    observed: Interface | None = None,
    *,
    reference: Interface | None = None,
    simulated: Mapping[str, Interface] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw interfaces in the plane, in mm, at equal scales; flat ones are stretched in y, and the axis says so.

    The measured interface is green, the undeformed one grey; simulated ones have labels for the legend, e.g. their
    inputs.
    """
    labels = {label: _wrapped(label) for label in simulated or {}}
    long = any(len(label) > _HALF_LINE for label in labels)
    lines = sum(label.count("\n") + 1 for label in labels.values()) if long else 0
    ax = ax or style.new_axes(style.DOUBLE, 3.9 + 0.14 * lines)
    if reference is not None:
        _draw(ax, reference, "undeformed", color=style.GREY, linewidth=1.2, linestyle=(0, (4, 2)))
    if observed is not None:
        _draw(ax, observed, "observed", color=style.GREEN, linewidth=3.5)
    for k, (label, interface) in enumerate((simulated or {}).items()):
        colour, dashes = (style.BLACK, *style.CYCLE)[k % 6], (*style.DASHES, "-")[k % 6]
        _draw(ax, interface, labels[label], color=colour, linewidth=1.2, linestyle=dashes)
    ax.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]")
    width, height = ax.dataLim.size
    if 0 < height < _FLAT * width:
        stretch = max(round(_FLAT * width / height), 2)
        ax.set(aspect=stretch, ylabel=f"y [mm], {stretch} × stretched")
    style.below(ax, columns=1 if long else 2, handlelength=3.2)
    return ax


@style.drawn()
def plot_conditions(
    observed: Mapping[str, Interface | None],
    *,
    reference: Interface | None = None,
    simulated: Mapping[str, Mapping[str, Interface]] | None = None,
) -> Figure:
    """Draw the interfaces of several conditions, one panel each, as `plot_interfaces` does for one.

    Each condition has simulated interfaces with the same labels, since one legend under the last panel explains all.
    """
    figure = style.new_figure(style.DOUBLE, 1.2 + 2.6 * len(observed))
    panels = figure.subplots(len(observed), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for ax, (condition, interface) in zip(panels, observed.items(), strict=True):
        plot_interfaces(interface, reference=reference, simulated=(simulated or {}).get(condition), ax=ax)
        ax.set_title(condition)
        if ax is not panels[-1]:
            ax.set_xlabel("")
            if (legend := ax.get_legend()) is not None:
                legend.remove()
    return figure


def _wrapped(label: str) -> str:
    """Return the label of many inputs in lines that fit under the axes."""
    if len(label) <= _HALF_LINE:
        return label
    return "\n".join(textwrap.wrap(label.replace(" = ", "\u00a0=\u00a0"), 2 * _HALF_LINE))


def _draw(ax: Axes, interface: Interface, label: str, **look: Any) -> None:
    if interface.dim != 2:
        found, remedy = f"{interface.dim} coordinates a point", "Cut the surface by a plane first."
        raise unfit(f"interface '{label}'", found, "a polyline in the plane", remedy)
    ends = interface.points[interface.cells[:, 1]]
    chain = np.concatenate([interface.points[interface.cells[:1, 0]], ends])
    ax.plot(*chain.T, label=label, **look)


@style.drawn(style.DOUBLE, 3.2)
def plot_run_offsets(observed: Offsets, runs: Mapping[str, Offsets], *, ax: Axes = style.NEW) -> Axes:
    """Draw the normal offsets, mm, of the observed interface and of some runs from the best run, the zero line."""
    for k, (label, found) in enumerate(runs.items()):
        colour, dashes = style.CYCLE[k % len(style.CYCLE)], style.DASHES[(k + 1) % len(style.DASHES)]
        offset = style.TO_MICROMETRES * found.offset
        ax.plot(found.arc_length, offset, color=colour, linestyle=dashes, linewidth=0.9, label=label)
    ax.axhline(0.0, color=style.BLACK, linewidth=0.9, label="best run")
    offset = style.TO_MICROMETRES * observed.offset
    ax.plot(observed.arc_length, offset, color=style.GREEN, linewidth=1.8, label="observed")
    ax.set(xlabel="arc length [mm]", ylabel="normal offset from the best run [µm]")
    style.below(ax, columns=2)
    return ax


@dataclass(frozen=True, eq=False)
class ResidualsAlong:
    """Residuals of one observed interface at arc lengths, all in mm: signed distances of the points from the
    prediction, the standard deviation that the noise allows, and the ends of the parts of the arc where residuals are
    too large.
    """

    arc_length: Float[np.ndarray, " point"]
    residual: Float[np.ndarray, " point"]
    sd: float
    conspicuous: tuple[tuple[float, float], ...] = ()


@style.drawn()
def plot_residuals(residuals: Mapping[str, ResidualsAlong]) -> Figure:
    """Draw the residuals in µm over the arc length with a band of ± 2 standard deviations, one panel a condition."""
    figure = style.new_figure(style.DOUBLE, 0.9 + 1.9 * len(residuals))
    panels = figure.subplots(len(residuals), 1, squeeze=False)[:, 0]
    for ax, (condition, along) in zip(panels, residuals.items(), strict=True):
        order, band = np.argsort(along.arc_length, kind="stable"), 2 * style.TO_MICROMETRES * along.sd
        values = style.TO_MICROMETRES * along.residual[order]
        ax.axhspan(-band, band, color=style.SKY, alpha=0.35, linewidth=0, label="noise, ± 2 sd")
        for k, (begin, end) in enumerate(along.conspicuous):
            label = "more than the noise allows" if k == 0 else None
            ax.axvspan(begin, end, color=style.RED, alpha=0.15, linewidth=0, label=label)
        ax.axhline(0.0, color=style.BLACK, linewidth=0.8, label="best fit")
        ax.plot(along.arc_length[order], values, color=style.GREEN, marker=".", markersize=3.0, label="observed")
        ax.set(ylabel="residual [µm]", title=condition)
    panels[-1].set_xlabel("arc length of the observed interface [mm]")
    style.legend_under(figure, style.labelled(*panels))
    return figure


Nodal = Float[np.ndarray, " point"]


@style.drawn()
def plot_flow(fields: Any, *, title: str = "") -> Figure:
    """Draw speed and pressure in the fluid and displacement magnitude in the solid, one below the other.

    The undeformed interface is grey; thin lines in the solid divide its parts. `fields` have the form of
    `strandline.models.biofilm.cells.fields.FlowFields`.
    """
    figure = style.new_figure(style.SINGLE, 5.4)
    speed, length = (np.linalg.norm(field, axis=1) for field in (fields.velocity, fields.displacement))
    fluid, solid = fields.cell_part == 0, fields.cell_part > 0
    panels = figure.subplots(3, 1, sharex=True, sharey=True)
    _panel(panels[0], fields, speed, fluid, "velocity magnitude [mm/s]", "viridis")
    _panel(panels[1], fields, fields.pressure, fluid, "pressure [Pa]", "cividis")
    _panel(panels[2], fields, length, solid, "displacement magnitude [mm]", "viridis")
    panels[-1].set_xlabel("x [mm]")
    if title:
        panels[0].set_title(title)
    return figure


def _edges_above(fields: Any, part: int) -> set[tuple[int, int]]:
    """Return the node numbers of the edges between a part, 0 being the fluid, and those with larger numbers."""
    return _edges(fields.triangles[fields.cell_part == part]) & _edges(fields.triangles[fields.cell_part > part])


def _edges(triangles: Int[np.ndarray, "cell 3"]) -> set[tuple[int, int]]:
    pairs = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    return set(map(tuple, pairs.tolist()))


def _panel(ax: Axes, fields: Any, values: Nodal, cells: Bool[np.ndarray, " cell"], label: str, colours: str) -> None:
    """Draw nodal `values` on the chosen cells; the others stay pale grey."""
    x, y = fields.points.T
    others = fields.triangles[~cells]
    if len(others):
        ax.tripcolor(x, y, others, facecolors=np.zeros(len(others)), cmap="Greys", vmin=-0.15, vmax=1.0)
    if cells.any():
        mesh = Triangulation(x, y, fields.triangles[cells])
        used = values[np.unique(fields.triangles[cells])]  # nodes elsewhere must not stretch the colours
        low, high = float(used.min()), float(used.max())
        high = high if high > low else low + 1.0  # nothing moves: the lowest colour, not the middle one
        drawn = ax.tripcolor(mesh, values, shading="gouraud", cmap=colours, vmin=low, vmax=high)
        ax.figure.colorbar(drawn, ax=ax, label=label, shrink=0.95, pad=0.02)
    interface = _edges_above(fields, 0)
    inner = set[tuple[int, int]]().union(*(_edges_above(fields, k) for k in range(1, int(fields.cell_part.max()) + 1)))
    rest, now = fields.points - fields.displacement, fields.points
    lines = (interface, rest, style.GREY, 0.9), (inner, now, style.BLACK, 0.6), (interface, now, style.BLACK, 1.2)
    for edges, points, colour, width in lines:
        segments = points[np.array(sorted(edges), int).reshape(-1, 2)]
        ax.add_collection(LineCollection(list(segments), colors=colour, linewidths=width))
    ax.margins(0.0)
    ax.set(aspect="equal", ylabel="y [mm]")
