"""What a posterior knows of a random field, along a line or over a plane."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation
from scipy.spatial import cKDTree

from strandline.foundations import unit_text
from strandline.posterior import FieldPosterior
from strandline.posterior.random_field import AXES
from strandline.report.plots import style

Values = Float[np.ndarray, " point"]
Draws = Float[np.ndarray, "draw point"]
FLAT = 1e-9
"""Extent of the points in a direction, relative to the largest one, below which they do not vary in it."""
NEIGHBOURS, LONG = 5, 2.5
"""A triangle is left out if a side is so many times longer than the distance of each corner to its fifth neighbour: on
a regular grid 3.5 times the spacing. Of four sets of 400 points at random, none inside was; with twice, up to seven."""
WIDE = 2.5
"""Width over height of a region from which two panels are side by side, not three."""
SHARE = "share of the prior's sd left"
DOTS = 9.0
"""Area of a point in space, points²."""


def directions(points: Float[np.ndarray, "point xyz"]) -> Int[np.ndarray, " direction"]:
    """Return the coordinates in which points vary, the one in which they extend most first."""
    extent = np.ptp(points, axis=0)
    return np.argsort(-extent, kind="stable")[: int((extent > FLAT * extent.max()).sum())]


@style.drawn()
def plot_random_field(found: FieldPosterior, *, truth: Values | None = None, draws: int = 3, seed: int = 0) -> Figure:
    """Draw mean and standard deviation of a field, the share of the prior's that is left, and some draws.

    Along a line, the mean has bands of 50 and 90 % with the prior's; in space, points are drawn in the two directions
    in which they extend most. `truth` are the values from which a synthetic observation was made.
    """
    along = directions(found.field.support.points)
    if len(along) == 1:
        return _along_line(found, int(along[0]), truth, found.draws(draws, seed))
    return _over_plane(found, np.sort(along[:2]), truth, found.draws(draws, seed))


def _along_line(found: FieldPosterior, axis: int, truth: Values | None, draws: Draws) -> Figure:
    figure = style.new_figure(style.DOUBLE, 4.2)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2.4, 1))
    x = found.field.support.points[:, axis]
    order = np.argsort(x)
    x = x[order]
    band: Any = {"linewidth": 0.0, "label": "prior 90 %"}
    top.fill_between(x, *found.prior.interval()[:, order], color=style.GREY, alpha=0.22, **band)
    for level, alpha in ((0.9, 0.35), (0.5, 0.75)):
        ends, band["label"] = found.interval(level)[:, order], f"posterior {100 * level:g} %"
        top.fill_between(x, *ends, color=style.SKY, alpha=alpha, **band)
    for k, values in enumerate(draws[:, order]):
        top.plot(x, values, color=style.BLACK, linewidth=0.5, alpha=0.7, label="" if k else "draws")
    top.plot(x, found.mean[order], color=style.BLUE, linewidth=1.8, label="mean")
    if truth is not None:
        top.plot(x, truth[order], color=style.RED, linestyle="--", label="ground truth")
    top.set(ylabel=_label(found), ylim=(0.0, None) if found.field.prior.log else None)
    bottom.plot(x, found.share_left[order], color=style.BLUE)
    bottom.axhline(1.0, color=style.GREY, linewidth=0.8, linestyle=":")
    bottom.set(xlabel=f"{AXES[axis]} [mm]", ylabel=SHARE.replace("of the ", "of the\n"))
    bottom.set(xlim=(x[0], x[-1]), ylim=(0.0, 1.08))
    style.legend_under(figure, style.labelled(top), columns=6)
    return figure


def _over_plane(
    found: FieldPosterior, along: Int[np.ndarray, " direction"], truth: Values | None, draws: Draws
) -> Figure:
    points = found.field.support.points
    xy = points[:, along]
    width, height = np.ptp(xy, axis=0)
    columns, unit = 2 if width > WIDE * height else 3, _label(found)
    draws = draws[: len(draws) - (truth is not None)]
    shown = {"mean": found.mean} | ({} if truth is None else {"ground truth": truth})
    shown |= {f"draw {k}": values for k, values in enumerate(draws, 1)}
    limits, sd = np.quantile(list(shown.values()), (0.005, 0.995)), found.sd
    sheets: list[tuple[str, Any, str, Any, str]] = [
        (title, values, "viridis", limits, unit) for title, values in shown.items()
    ]
    sheets[1:1] = [
        ("standard deviation", sd, "magma", (0.0, sd.max()), unit),
        (SHARE, found.share_left, "cividis", (0.0, 1.0), "share"),
    ]
    across = style.DOUBLE / columns - 1.0
    row = min(max(across * height / width, 0.35), 3.2) + 0.55
    figure, panels = style.panel_grid(len(sheets), row, columns=columns, margin=0.1, sharex=True, sharey=True)
    triangles = _triangles(xy) if len(directions(points)) == 2 else None
    for k, (ax, (title, values, colours, ends, label)) in enumerate(zip(panels, sheets, strict=True)):
        look: Any = {"cmap": colours, "vmin": ends[0], "vmax": ends[1], "rasterized": True}
        drawn: Any
        if triangles is None:
            drawn = ax.scatter(xy[:, 0], xy[:, 1], DOTS, values, linewidths=0.0, **look)
        else:
            drawn = ax.tripcolor(triangles, values, shading="gouraud", **look)
        first, last = k % columns == 0, k + columns >= len(sheets)
        ax.set(title=title, aspect="equal")
        ax.set(xlabel=f"{AXES[along[0]]} [mm]" if last else "", ylabel=f"{AXES[along[1]]} [mm]" if first else "")
        ax.tick_params(labelbottom=last, labelleft=first)
        figure.colorbar(drawn, ax=ax, label=label, pad=0.02, shrink=0.95)
    return figure


def _triangles(xy: Float[np.ndarray, "point 2"]) -> Triangulation:
    """Return Delaunay's triangles without those that bridge a gap or an indentation."""
    found = Triangulation(*xy.T)
    corners = xy[found.triangles]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    near = cKDTree(xy).query(xy, k=NEIGHBOURS + 1)[0][:, NEIGHBOURS]
    found.set_mask(sides.max(axis=1) > LONG * near[found.triangles].max(axis=1))
    return found


def _label(found: FieldPosterior) -> str:
    unit = unit_text(found.field.unit).replace("$", r"\$")
    name = found.field.name.replace("$", r"\$")
    return f"{name} [{unit}]" if unit else name
