"""results.json, the figures of all parts, and machine.json, the machine they were measured on."""

import json
import math
import os
import platform
import re
from collections.abc import Iterable
from dataclasses import asdict, replace
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from verification.benchmarks.figures import Figure

HERE = Path(__file__).parent
RESULTS, MACHINE, SCALING = (HERE / f"{name}.json" for name in ("results", "machine", "scaling"))
PARTS = ("inference", "surrogate", "sampler", "norms", "executors", "startup", "forward", "scaling")
PACKAGES = ("strandline", "numpy", "scipy", "jax", "jaxlib", "scikit-learn", "blackjax", "ngsolve", "mkl")
UNITS = ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs"), (1e-9, "ns"))
USUAL = asdict(Figure(""))


def load(path: Path = RESULTS) -> list[Figure]:
    """Return the figures of all parts; none without the file."""
    return [Figure(**one) for one in json.loads(path.read_text("utf-8"))] if path.exists() else []


def save(part: str, found: Iterable[Figure], path: Path = RESULTS) -> None:
    """Replace the figures of a part in the list, which is in the order of `PARTS`."""
    kept = [one for one in load(path) if one.part != part] + [replace(one, part=part) for one in found]
    kept.sort(key=lambda one: PARTS.index(one.part))
    write(path, [{key: value for key, value in asdict(one).items() if value != USUAL[key]} for one in kept])


def row(figure: Figure) -> tuple[str, ...]:
    """Return a figure as text: task, peer, our number, the peer's, their ratio, that per core, remark."""
    numbers = amount(figure.ours, figure.unit), amount(figure.peer, figure.unit)
    ratios = ratio(figure.ratio), ratio(figure.ratio_per_core)
    remark = figure.remark if figure.ours is not None else f"not measured: {figure.remark}"
    return figure.task, figure.peer_name, *numbers, *ratios, remark


def ratio(value: float | None) -> str:
    """Return a ratio as text, with three digits."""
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


def note_run(part: str, *, seconds: float, load_average: float) -> None:
    """Note when a part was run, and keep the notes of other parts from the same machine with the same packages."""
    known, machine = machine_of_results(), this_machine()
    runs = known["runs"] if machine.items() <= known.items() else {}
    date = datetime.now(UTC).isoformat(timespec="minutes")
    runs[part] = {"date": date, "seconds": round(seconds, 1), "load_average_before": round(load_average, 2)}
    write(MACHINE, {**machine, "runs": runs})


def machine_of_results() -> dict[str, Any]:
    """Return the machine that the figures were measured on, and when each part was; nothing if there are none."""
    return json.loads(MACHINE.read_text("utf-8")) if MACHINE.exists() else {}


def this_machine() -> dict[str, Any]:
    """Return a description of the machine and the packages, which times depend on."""
    described = Path("/proc/cpuinfo")
    cpu = re.search(r"model name\s*:\s*(.+)", described.read_text("utf-8")) if described.exists() else None
    installed = {one.name.lower(): one.version for one in metadata.distributions()}
    return {
        "cpu": cpu[1] if cpu else platform.processor() or "unknown",
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "unset"),
        "python": platform.python_version(),
        "versions": {name: installed[name] for name in PACKAGES if name in installed},
    }


def write(path: Path, content: object) -> None:
    """Write JSON in one piece."""
    draft = path.with_suffix(".part")
    draft.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    draft.replace(path)
