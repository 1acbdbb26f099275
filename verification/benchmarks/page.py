"""Tables and figure of docs/results/speed.md from the results: ``python -m verification.benchmarks.page``.

The figure shows core-seconds in its upper panels and shares of a core's peak in its lower ones.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator
from verification.benchmarks.aims import FIGURES, PER_CORE, RATIO
from verification.benchmarks.results import MACHINE, PARTS, SCALING, amount, load, ratio, row, task
from verification.validation.tables import Table, put_into_page

from strandline.report.plots.style import BLUE, GREY, RED, styled

DOCS = Path(__file__).parents[2] / "docs"
PAGE = DOCS / "results" / "speed.md"
FIGURE = DOCS / "figures" / "bench-scaling.png"
AXES = ("runs", "particles", "inputs", "triangles")
POWERS = {"runs": 3, "particles": 1, "triangles": 2}
LOOKS = ((BLUE, "o-"), (RED, "s--"))


def tables(records: Sequence[Mapping[str, Any]], machine: Mapping[str, Any]) -> Iterator[Table]:
    """Yield the tables of the page: aims, the figures of each part, the machine."""
    with_aim = [record for record in records if record["aim"] is not None]
    yield _table("aims", ("task", "against", "figure", "aim", "met"), _rows(with_aim, aim_row))
    columns = ("task", "against", "strandline", "other", "ratio", "per core", "remark")
    for part in PARTS:
        yield _table(part, columns, _rows([record for record in records if record["part"] == part], row))
    facts = tuple((name, _text(value)) for name, value in machine.items() if name != "runs")
    yield _table("machine", ("what", "value"), facts)
    runs = tuple(
        (part, run["date"], f"{run['seconds']:.0f}", _text(run["load_average_before"]))
        for part, run in machine["runs"].items()
    )
    yield _table("runs", ("part", "begun before, UTC", "s", "load average before"), runs)


def _table(name: str, columns: tuple[str, ...], cells: tuple[tuple[str, ...], ...]) -> Table:
    return Table(f"bench_{name}", name, columns, len(columns) * ("s",), cells)


def _rows(records: Sequence[Mapping[str, Any]], line: Callable[..., tuple[str, ...]]) -> tuple[tuple[str, ...], ...]:
    return tuple(tuple(cell.replace("|", "\\|") for cell in line(record)) for record in records)


def aim_row(record: Mapping[str, Any]) -> tuple[str, ...]:
    """Return task, peer, the figure that the aim applies to, the aim, and whether it is met."""
    kind, unit = record["aim_kind"], record.get("unit", "")
    figure = record.get(FIGURES[kind])
    if kind in (RATIO, PER_CORE):
        value, bound = ratio(figure), f"{record['aim']:.3g}"
    else:
        value, bound = amount(figure, unit), amount(record["aim"], unit)
    met = {True: "yes", False: "**no**", None: "not measured"}[record["met"]]
    return task(record), record.get("peer_name", ""), value, f"{kind} {bound}", met


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {inner}" for name, inner in value.items())
    return "unknown" if value is None else str(value)


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
    PAGE.write_text(put_into_page(PAGE.read_text("utf-8"), list(tables(load(), load(MACHINE)))), encoding="utf-8")
    if SCALING.exists():
        draw(load(SCALING), FIGURE)
