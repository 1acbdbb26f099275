"""The observed interface among the undeformed and some simulated ones (Fig. 4)."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes

from strandline.errors import InvalidInput
from strandline.interface import Interface
from strandline.plots.style import BLACK, CYCLE, DASHES, GREEN, GREY, axes_or_new, below, styled

__all__ = ["plot_interfaces"]


def plot_interfaces(
    observed: Interface | None = None,
    *,
    reference: Interface | None = None,
    simulated: Mapping[str, Interface] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw interfaces in the plane, in mm, at equal scales.

    Args:
        observed: the measured interface, green.
        reference: the undeformed interface, grey.
        simulated: interfaces by the label that the legend gives them, e.g. their inputs.
        ax: axes to draw in.
    """
    with styled():
        ax = axes_or_new(ax, (6.2, 3.6))
        if reference is not None:
            _draw(ax, reference, GREY, "undeformed", width=1.2, style=(0, (4, 2)))
        if observed is not None:
            _draw(ax, observed, GREEN, "observed", width=3.5)
        for k, (label, interface) in enumerate((simulated or {}).items()):
            _draw(ax, interface, (BLACK, *CYCLE)[k % 6], label, width=1.2, style=(*DASHES, "-")[k % 6])
        ax.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]")
        below(ax, columns=2, handlelength=3.2)
    return ax


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
