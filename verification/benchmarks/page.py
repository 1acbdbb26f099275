"""Tables and figure of docs/results/speed.md from the results: ``python -m verification.benchmarks.page``."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from verification.benchmarks import plots, results
from verification.benchmarks.__main__ import PARTS
from verification.benchmarks.aims import FIGURES, PER_CORE, RATIO
from verification.validation.tables import Table, put_into_page

DOCS = Path(__file__).parents[2] / "docs"
PAGE = DOCS / "results" / "speed.md"
FIGURE = DOCS / "figures" / "bench-scaling.png"
UNITS = ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs"), (1e-9, "ns"))


def tables(records: Sequence[Mapping[str, Any]], machine: Mapping[str, Any]) -> Iterator[Table]:
    """Yield the tables of the page: aims, the figures of each part, the machine."""
    with_aim = [record for record in records if record["aim"] is not None]
    yield Table("bench_aims", "Aims", ("task", "against", "figure", "aim", "met"), 5 * ("s",), rows(with_aim, aim_row))
    columns = ("task", "against", "strandline", "other", "ratio", "per core", "remark")
    for part in PARTS:
        own = [record for record in records if record["part"] == part]
        yield Table(f"bench_{part}", part, columns, 7 * ("s",), rows(own, row))
    facts = tuple((name, text(value)) for name, value in machine.items() if name != "runs")
    yield Table("bench_machine", "Machine", ("what", "value"), ("s", "s"), facts)
    runs = tuple(
        (part, run["date"], f"{run['seconds']:.0f}", text(run["load_average_before"]))
        for part, run in machine["runs"].items()
    )
    yield Table("bench_runs", "Runs", ("part", "begun before, UTC", "s", "load average before"), 4 * ("s",), runs)


def rows(records: Sequence[Mapping[str, Any]], line: Any) -> tuple[tuple[str, ...], ...]:
    return tuple(tuple(cell.replace("|", "\\|") for cell in line(record)) for record in records)


def aim_row(record: Mapping[str, Any]) -> tuple[str, ...]:
    """Return task, peer, the figure that the aim applies to, the aim, and whether it is met."""
    kind = record["aim_kind"]
    figure = record.get(FIGURES[kind])
    if kind in (RATIO, PER_CORE):
        value, bound = ratio(figure), f"{kind} {record['aim']:.3g}"
    else:
        value, bound = amount(figure, record.get("unit", "")), f"{kind} {amount(record['aim'], record.get('unit', ''))}"
    met = {True: "yes", False: "**no**", None: "not measured"}[record["met"]]
    return task(record), record.get("peer_name", ""), value, bound, met


def row(record: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the cells of one figure."""
    unit = record.get("unit", "")
    return (
        task(record),
        record.get("peer_name", ""),
        amount(record["ours"], unit),
        amount(record["peer"], unit),
        ratio(record["ratio"]),
        ratio(record.get("ratio_per_core")),
        record["remark"],
    )


def task(record: Mapping[str, Any]) -> str:
    return ", ".join(filter(None, (record["what"], record.get("case", ""))))


def ratio(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}" if value < 100 else f"{value:.0f}"


def amount(value: float | None, unit: str) -> str:
    """Return a number with its unit; seconds in a suitable multiple."""
    if value is None:
        return ""
    if unit.split(" ")[0] != "s" or value <= 0:
        return f"{digits(value)} {unit}".strip()
    size, name = next(((size, name) for size, name in UNITS if value >= size), UNITS[-1])
    return f"{digits(value / size)} {name}{unit[1:]}"


def digits(value: float) -> str:
    """Return a number with three significant digits; large ones as whole numbers or powers of ten."""
    if value == 0 or abs(value) >= 1e6 or abs(value) < 1e-3:
        return f"{value:.3g}"
    return f"{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}"


def text(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {inner}" for name, inner in value.items())
    return "unknown" if value is None else str(value)


def main() -> None:
    """Write the tables between the marks of the page and draw the figure."""
    machine = json.loads(results.MACHINE.read_text("utf-8"))
    page = put_into_page(PAGE.read_text("utf-8"), list(tables(results.load(), machine)))
    PAGE.write_text(page, encoding="utf-8")
    if results.SCALING.exists():
        plots.draw(plots.load(results.SCALING), FIGURE)


if __name__ == "__main__":
    main()
