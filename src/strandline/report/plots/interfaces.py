"""The observed interface among the undeformed and some simulated ones (Fig. 4)."""

import textwrap
from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from strandline.errors import InvalidInput
from strandline.interface import Interface
from strandline.report.plots.style import (
    BLACK,
    CYCLE,
    DASHES,
    DOUBLE,
    GREEN,
    GREY,
    axes_or_new,
    below,
    figure_or_new,
    styled,
)

__all__ = ["plot_conditions", "plot_interfaces"]

_HALF_LINE = 38
"""Characters of a label that leave room for a second one next to it."""
_FLAT = 0.3
"""Least height of the drawn interfaces, relative to their width; flatter ones are stretched."""


def plot_interfaces(
    observed: Interface | None = None,
    *,
    reference: Interface | None = None,
    simulated: Mapping[str, Interface] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw interfaces in the plane, in mm, at equal scales; flat ones are stretched in y, and the axis says so.

    Args:
        observed: the measured interface, green.
        reference: the undeformed interface, grey.
        simulated: interfaces by their label in the legend, e.g. their inputs.
        ax: axes to draw in.
    """
    labels = {label: _wrapped(label) for label in simulated or {}}
    long = any(len(label) > _HALF_LINE for label in labels)
    lines = sum(label.count("\n") + 1 for label in labels.values()) if long else 0
    with styled():
        ax = axes_or_new(ax, (DOUBLE, 3.9 + 0.14 * lines))
        if reference is not None:
            _draw(ax, reference, GREY, "undeformed", width=1.2, style=(0, (4, 2)))
        if observed is not None:
            _draw(ax, observed, GREEN, "observed", width=3.5)
        for k, (label, interface) in enumerate((simulated or {}).items()):
            _draw(ax, interface, (BLACK, *CYCLE)[k % 6], labels[label], width=1.2, style=(*DASHES, "-")[k % 6])
        ax.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]")
        width, height = ax.dataLim.size
        if 0 < height < _FLAT * width:
            stretch = max(round(_FLAT * width / height), 2)
            ax.set(aspect=stretch, ylabel=f"y [mm], {stretch} × stretched")
        below(ax, columns=1 if long else 2, handlelength=3.2)
    return ax


def plot_conditions(
    observed: Mapping[str, Interface | None],
    *,
    reference: Interface | None = None,
    simulated: Mapping[str, Mapping[str, Interface]] | None = None,
    figure: Figure | SubFigure | None = None,
) -> Figure | SubFigure:
    """Draw the interfaces of several conditions, one panel each, as `plot_interfaces` does for one.

    Args:
        observed: Observed interfaces by condition; None for a condition that was not observed.
        reference: The undeformed interface of the specimen.
        simulated: Simulated interfaces by condition and label; each condition has the same labels, since one legend
            under the last panel explains all.
        figure: Figure to draw in; a new one by default.
    """
    with styled():
        figure = figure_or_new(figure, (DOUBLE, 1.2 + 2.6 * len(observed)))
        panels = figure.subplots(len(observed), 1, sharex=True, squeeze=False)[:, 0]
        for ax, (condition, interface) in zip(panels, observed.items(), strict=True):
            plot_interfaces(interface, reference=reference, simulated=(simulated or {}).get(condition), ax=ax)
            ax.set_title(condition)
            if ax is not panels[-1]:
                ax.set_xlabel("")
                legend = ax.get_legend()
                if legend is not None:
                    legend.remove()
    return figure


def _wrapped(label: str) -> str:
    """Return the label of many inputs in lines that fit under the axes."""
    if len(label) <= _HALF_LINE:
        return label
    return "\n".join(textwrap.wrap(label.replace(" = ", "\u00a0=\u00a0"), 2 * _HALF_LINE))


def _draw(
    ax: Axes,
    interface: Interface,
    colour: str,
    label: str,
    *,
    width: float,
    style: str | tuple[int, tuple[int, ...]] = "-",
) -> None:
    if interface.dim != 2:
        raise InvalidInput(
            f"interface '{label}'",
            value=f"{interface.dim} coordinates a point",
            expected="a polyline in the plane",
            remedy="Cut the surface by a plane first.",
        )
    ends = interface.points[interface.cells[:, 1]]
    chain = np.concatenate([interface.points[interface.cells[:1, 0]], ends])
    ax.plot(*chain.T, color=colour, linewidth=width, linestyle=style, label=label)
