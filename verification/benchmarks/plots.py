"""The figure of scaling.json: core-seconds in the upper panels, shares of a core's peak in the lower ones."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator

from strandline.report.plots.style import BLUE, GREY, RED, styled

AXES = ("runs", "particles", "inputs", "triangles")
POWERS = {"runs": 3, "particles": 1, "triangles": 2}
LOOKS = ((BLUE, "o-"), (RED, "s--"))


def draw(content: Mapping[str, Any], path: Path) -> None:
    """Write the figure; `content` is the content of scaling.json."""
    with styled():
        figure = Figure(figsize=(10.0, 5.0), layout="constrained")
        grid = figure.subplots(2, len(AXES), sharex="col")
        for (above, below), name in zip(grid.T, AXES, strict=True):
            series = [one for one in content["series"] if one["axis"] == name]
            seconds(above, series)
            shares(below, series, content["peaks"])
            below.set_xlabel(name)
        grid[0, 0].set_ylabel("core-seconds")
        grid[1, 0].set_ylabel("share of the peak, %")
        figure.savefig(path, dpi=130)


def seconds(ax: Axes, series: Sequence[Mapping[str, Any]]) -> None:
    """Draw times on logarithmic scales, and a line with the slope by which the operations grow."""
    plot = ax.semilogy if series and series[0]["axis"] == "inputs" else ax.loglog
    for one, (colour, style) in zip(series, LOOKS, strict=False):
        x, y = coordinates(one, "x"), coordinates(one, "seconds")
        plot(x, y, style, color=colour, markersize=4, label=one["name"])
        if one["axis"] in POWERS and one["limit"] is not None:
            power = POWERS[one["axis"]]
            line = y[-1] * (x / x[-1]) ** power
            plot(x, line, ":", color=GREY, linewidth=1.0)
            label = {"xytext": (5, -3), "textcoords": "offset points", "va": "top", "color": GREY, "fontsize": 7.0}
            ax.annotate(f"slope {power}", (x[1], line[1]), **label)
    ax.set_ylim(top=ax.get_ylim()[1] * 4)  # room for the legend
    ax.legend(loc="upper left")


def shares(ax: Axes, series: Sequence[Mapping[str, Any]], peaks: Mapping[str, float]) -> None:
    """Draw the share of the peak for the series that have one."""
    for one, (colour, style) in zip(series, LOOKS, strict=False):
        if one["limit"] is not None:
            reached = 100 * coordinates(one, "operations") / coordinates(one, "seconds") / peaks[one["limit"]]
            ax.plot(coordinates(one, "x"), reached, style, color=colour, markersize=4, label=f"of {one['limit']}")
    if series and series[0]["axis"] != "inputs":
        ax.set_xscale("log")
    if series:
        places = coordinates(series[0], "x")
        ax.xaxis.set_major_locator(FixedLocator(places.tolist()))
        ax.xaxis.set_minor_locator(NullLocator())
        ax.set_xticklabels([short(place) for place in places], rotation=0)
    ax.set_ylim(0, max(100.0, ax.get_ylim()[1]))
    if ax.get_legend_handles_labels()[0]:
        ax.legend(loc="upper left")


def coordinates(series: Mapping[str, Any], key: str) -> np.ndarray:
    return np.array([point[key] for point in series["points"]], float)


def short(number: float) -> str:
    """Return a number as short text, in thousands (k) from 950 on."""
    return f"{number:.0f}" if number < 950 else f"{number / 1000:.0f}k"


def load(path: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(path.read_text("utf-8"))
    return content
