"""Tables and figure of docs/results/speed.md from the results: ``python -m verification.benchmarks.page``.

The figure shows core-seconds in its upper panels and shares of a core's peak in its lower ones.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator
from verification.benchmarks.aims import PER_CORE, RATIO, Aim, with_aims
from verification.benchmarks.figures import Figure as Measured
from verification.benchmarks.results import PARTS, SCALING, amount, load, machine_of_results, ratio, row
from verification.validation.tables import DOCS, Table, put_into_page

from strandline.report.plots.style import BLUE, GREY, RED, styled

PAGE = DOCS / "results" / "speed.md"
FIGURE = DOCS / "figures" / "bench-scaling.png"
AXES = ("runs", "particles", "inputs", "triangles")
POWERS = {"runs": 3, "particles": 1, "triangles": 2}
LOOKS = ((BLUE, "o-"), (RED, "s--"))


def tables(figures: Sequence[Measured], machine: Mapping[str, Any]) -> Iterator[Table]:
    """Yield the tables of the page: aims, the figures of each part, the machine."""
    yield _table("aims", ("task", "against", "figure", "aim", "met"), [_aim_row(*pair) for pair in with_aims(figures)])
    columns = ("task", "against", "strandline", "other", "ratio", "per core", "remark")
    for part in PARTS:
        yield _table(part, columns, [row(one) for one in figures if one.part == part])
    facts = {name: value for name, value in machine.items() if name != "runs"}
    facts["versions"] = ", ".join(f"{name} {version}" for name, version in facts["versions"].items())
    yield _table("machine", ("what", "value"), [(name, str(value)) for name, value in facts.items()])
    runs = [
        (part, run["date"], f"{run['seconds']:.0f}", str(run["load_average_before"]))
        for part, run in machine["runs"].items()
    ]
    yield _table("runs", ("part", "begun before, UTC", "s", "load average before"), runs)


def _table(name: str, columns: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> Table:
    cells = tuple(tuple(cell.replace("|", "\\|") for cell in line) for line in rows)
    return Table(f"bench_{name}", name, columns, len(columns) * ("s",), cells)


def _aim_row(figure: Measured, aim: Aim) -> tuple[str, ...]:
    """Return task, peer, the figure that the aim applies to, the aim, and whether it is met."""
    if aim.kind in (RATIO, PER_CORE):
        value, bound = ratio(aim.value(figure)), f"{aim.bound:.3g}"
    else:
        value, bound = amount(aim.value(figure), aim.peer_or_unit), amount(aim.bound, aim.peer_or_unit)
    met = {True: "yes", False: "**no**", None: "not measured"}[aim.met(figure)]
    return figure.task, figure.peer_name, value, f"{aim.kind} {bound}", met


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
        x, y = _coordinates(one, "x"), _coordinates(one, "seconds")
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
            reached = 100 * _coordinates(one, "operations") / _coordinates(one, "seconds") / peaks[one["limit"]]
            ax.plot(_coordinates(one, "x"), reached, style, color=colour, markersize=4, label=f"of {one['limit']}")
    if series:
        places = _coordinates(series[0], "x")
        ax.set_xscale("linear" if series[0]["axis"] == "inputs" else "log")
        ax.xaxis.set_major_locator(FixedLocator(places.tolist()))
        ax.xaxis.set_minor_locator(NullLocator())
        ax.set_xticklabels([f"{place:.0f}" if place < 950 else f"{place / 1000:.0f}k" for place in places], rotation=0)
    ax.set_ylim(0, max(100.0, ax.get_ylim()[1]))
    if ax.get_legend_handles_labels()[0]:
        ax.legend(loc="upper left")


def _coordinates(series: Mapping[str, Any], key: str) -> np.ndarray:
    return np.array([point[key] for point in series["points"]], float)


if __name__ == "__main__":
    PAGE.write_text(put_into_page(PAGE.read_text("utf-8"), list(tables(load(), machine_of_results()))), "utf-8")
    if SCALING.exists():
        draw(json.loads(SCALING.read_text("utf-8")), FIGURE)
