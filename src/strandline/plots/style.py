"""What all figures share: colours that colour-blind readers can tell apart, type sizes, axes out of nothing.

Figures are made without pyplot, so none is kept alive by a global register and none needs closing.
"""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from strandline.errors import InvalidInput

__all__ = ["BLACK", "BLUE", "GREEN", "GREY", "ORANGE", "PURPLE", "RED", "SKY", "styled"]

BLACK, GREY = "#000000", "#8c8c8c"
ORANGE, SKY, GREEN, BLUE, RED, PURPLE = "#E69F00", "#56B4E9", "#009E73", "#0072B2", "#D55E00", "#CC79A7"
CYCLE = (BLUE, RED, PURPLE, SKY, ORANGE)
"""Okabe and Ito's palette; green is kept for what was observed."""
DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)))
"""Line styles that go with CYCLE, for print without colour."""

_STYLE: Any = {
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9.0,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "lines.linewidth": 1.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
}


def styled() -> AbstractContextManager[None]:
    """Return the context in which figures are drawn."""
    return mpl.rc_context(_STYLE)


def axes_or_new(ax: Axes | None, size: tuple[float, float] = (4.6, 3.4)) -> Axes:
    """Return `ax`, or the axes of a new figure of `size` inches."""
    return new_figure(size).add_subplot() if ax is None else ax


def figure_or_new(figure: Figure | SubFigure | None, size: tuple[float, float]) -> Figure | SubFigure:
    """Return `figure`, or a new one of `size` inches."""
    return new_figure(size) if figure is None else figure


def new_figure(size: tuple[float, float]) -> Figure:
    """Return an empty figure whose parts are laid out so that nothing overlaps."""
    return Figure(figsize=size, layout="constrained")


def figure_of(ax: Axes) -> Figure | SubFigure:
    """Return the figure or sub-figure that holds `ax`."""
    figure = ax.get_figure()
    if figure is None:
        raise InvalidInput(
            "axes to draw in",
            value="axes that were removed from their figure",
            expected="axes of a figure",
            remedy="Leave `ax` out and a figure is made.",
        )
    return figure


def mark(
    ax: Axes,
    point: Sequence[float] | Float[np.ndarray, "2"],
    colour: str,
    label: str,
    *,
    marker: str = "x",
    size: float = 8.0,
) -> None:
    """Draw one cross (or another marker) with a white rim, above everything else."""
    rim = [patheffects.withStroke(linewidth=3.6, foreground="white")]
    ax.plot(
        *np.asarray(point, float)[:, None],
        marker=marker,
        color=colour,
        markersize=size,
        markeredgewidth=2.0,
        linestyle="none",
        fillstyle="none",
        label=label,
        zorder=10,
        path_effects=rim,
    )


def below(ax: Axes, *, columns: int = 3, **options: Any) -> None:
    """Put the legend of `ax`, where it has entries, under its x axis."""
    if ax.get_legend_handles_labels()[0]:
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=columns, **options)


def root_scale(top: float) -> tuple[Callable[[Any], Any], Callable[[Any], Any]]:
    """Return a scale for log densities and its inverse: signed square roots of the distance from `top`.

    Under a normal density it is linear in the number of standard deviations from the mode, so that the neighbourhood
    of the mode is seen even if the log density falls by thousands elsewhere.
    """

    def forward(value: Any) -> Any:
        return np.sign(value - top) * np.sqrt(np.abs(value - top))

    def inverse(root: Any) -> Any:
        return top + root * np.abs(root)

    return forward, inverse


def root_ticks(low: float, top: float, *, number: int = 4) -> tuple[list[float], list[str]]:
    """Return places and labels of ticks about equally spaced on the `root_scale`: `top` itself and round values."""
    drops = (top - low) * (np.arange(1, number + 1) / number) ** 2
    decades = 10.0 ** np.floor(np.log10(drops))
    steps = np.where(drops < 2.5 * decades, 0.2, 1.0) * decades
    places = [top, *(np.ceil((top - drops) / steps) * steps).tolist()]
    return places, [f"{round(top, 2) + 0.0:g}", *(f"{place:g}" for place in places[1:])]


def percent(fractions: Sequence[float]) -> str:
    """Return fractions as text: ``10, 50, 90 %``."""
    return ", ".join(f"{100 * p:g}" for p in fractions) + " %"
