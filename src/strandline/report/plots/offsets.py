"""How far interfaces lie from one of them along its normals, in µm: a plot in millimetres would not show it."""

from collections.abc import Mapping

from matplotlib.axes import Axes

from strandline.posterior import Offsets
from strandline.report.plots.style import BLACK, CYCLE, DASHES, DOUBLE, GREEN, axes_or_new, below, styled

__all__ = ["plot_run_offsets"]

MM_TO_MICROMETRES = 1e3


def plot_run_offsets(
    observed: Offsets, runs: Mapping[str, Offsets], *, centre: str = "best run", ax: Axes | None = None
) -> Axes:
    """Draw the normal offsets of the observed interface and of some runs from the `centre`, which is the zero line.

    Args:
        observed: Offsets of the observed points, mm.
        runs: Offsets of other runs, mm, by their label in the legend.
        centre: Name of the zero line.
        ax: Axes to draw in.
    """
    with styled():
        ax = axes_or_new(ax, (DOUBLE, 3.2))
        for k, (label, found) in enumerate(runs.items()):
            colour, dashes = CYCLE[k % len(CYCLE)], DASHES[(k + 1) % len(DASHES)]
            offset = MM_TO_MICROMETRES * found.offset
            ax.plot(found.arc_length, offset, color=colour, linestyle=dashes, linewidth=0.9, label=label)
        ax.axhline(0.0, color=BLACK, linewidth=0.9, label=centre)
        ax.plot(observed.arc_length, MM_TO_MICROMETRES * observed.offset, color=GREEN, linewidth=1.8, label="observed")
        ax.set(xlabel="arc length [mm]", ylabel=f"normal offset from the {centre} [µm]")
        below(ax, columns=2)
    return ax
