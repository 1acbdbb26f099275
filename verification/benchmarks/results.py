"""results.json, a list of {what, ours, peer, ratio, aim, met}; and the machine it was measured on.

A figure with a peer has the seconds of both and their ratio, above 1 if strandline is faster. A figure without one has
`ours` in its `unit`. What was not measured has nulls and a remark with the reason; so has an aim without a figure.
"""

import json
import math
import os
import platform
import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from verification.benchmarks.aims import AIMS, LEAST, MOST, aim_of
from verification.benchmarks.figures import Figure

HERE = Path(__file__).parent
RESULTS, MACHINE, SCALING = (HERE / f"{name}.json" for name in ("results", "machine", "scaling"))
PARTS = ("inference", "surrogate", "sampler", "norms", "executors", "startup", "forward", "scaling")
PACKAGES = ("strandline", "numpy", "scipy", "jax", "jaxlib", "scikit-learn", "blackjax", "ngsolve", "mkl")
MISSING = "not measured: there is no such figure"
UNITS = ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs"), (1e-9, "ns"))

Record = dict[str, Any]


def load(path: Path = RESULTS) -> Any:
    """Return the figures of all parts, or what else a file says; an empty list without the file."""
    return json.loads(path.read_text("utf-8")) if path.exists() else []


def save(part: str, found: Sequence[Figure], path: Path = RESULTS) -> None:
    """Replace the figures of a part in the list, which is in the order of `PARTS`; each aim has a figure."""
    kept = [record for record in load(path) if record["part"] != part and record["remark"] != MISSING]
    kept += [judged(one, part) for one in found]
    kept += [missing(aim) for aim in AIMS if not any(aim_of(one) is aim for one in kept)]
    write(path, sorted(kept, key=lambda record: PARTS.index(record["part"])))


def judged(figure: Figure, part: str) -> Record:
    """Return a figure as a record of the list, with its aim."""
    numbers: Record = {"ours": figure.ours, "peer": figure.peer, "ratio": figure.ratio}
    rest: Record = {"unit": figure.unit}
    if figure.cpu:
        ours, peer = figure.cpu
        rest |= {"cpu_ours": ours, "cpu_peer": peer, "ratio_per_core": peer / ours}
    rest |= {"part": part}
    rest |= {key: value for key in ("case", "peer_name", "repeats") if (value := getattr(figure, key))}
    measured = figure.ours is not None or figure.remark.startswith("not measured")
    rest |= {"remark": figure.remark if measured else f"not measured: {figure.remark}"}
    record = {"what": figure.what, **numbers, **rest}
    aim = aim_of(record)
    bound = {"aim": aim.bound, "met": aim.met(record), "aim_kind": aim.kind} if aim else {"aim": None, "met": None}
    return {"what": figure.what, **numbers, **bound, **rest}


def missing(aim: Any) -> Record:
    """Return the line for an aim without a figure."""
    unit = {"unit": aim.peer_or_unit} if aim.kind in (MOST, LEAST) else {}
    judgement = {"aim": aim.bound, "met": None, "aim_kind": aim.kind, "part": aim.part}
    return {"what": aim.name, "ours": None, "peer": None, "ratio": None, **judgement, **unit, "remark": MISSING}


def row(record: Mapping[str, Any]) -> tuple[str, ...]:
    """Return a figure as text: task, peer, our number, the peer's, their ratio, that per core, remark."""
    unit = record.get("unit", "")
    numbers = amount(record["ours"], unit), amount(record["peer"], unit)
    ratios = ratio(record["ratio"]), ratio(record.get("ratio_per_core"))
    return task(record), record.get("peer_name", ""), *numbers, *ratios, record["remark"]


def task(record: Mapping[str, Any]) -> str:
    """Return the task of a record with its case."""
    return ", ".join(filter(None, (record["what"], record.get("case", ""))))


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


def note_run(part: str, *, seconds: float, load_average: float | None) -> None:
    """Note when a part was run, and keep the notes of other parts from the same machine with the same packages."""
    runs = load(MACHINE)["runs"] if from_this_machine() else {}
    date = datetime.now(UTC).isoformat(timespec="minutes")
    runs[part] = {"date": date, "seconds": round(seconds, 1), "load_average_before": load_average}
    write(MACHINE, {**this_machine(), "runs": runs})


def from_this_machine() -> bool:
    """Return whether the known figures were measured on this machine with these packages."""
    known = dict(load(MACHINE))
    return all(known.get(key) == value for key, value in this_machine().items())


def this_machine() -> dict[str, Any]:
    """Return a description of the machine and the packages, which times depend on."""
    return {
        "cpu": _cpu_model(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "unset"),
        "python": platform.python_version(),
        "versions": {name: version for name in PACKAGES if (version := _installed(name))},
    }


def _cpu_model() -> str:
    described = Path("/proc/cpuinfo")
    found = re.search(r"model name\s*:\s*(.+)", described.read_text("utf-8")) if described.exists() else None
    return found[1] if found else platform.processor() or "unknown"


def load_average() -> float | None:
    """Return the mean number of processes that needed a core during the last minute, if the system reports it."""
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None


def _installed(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def write(path: Path, content: object) -> None:
    """Write JSON in one piece."""
    draft = path.with_suffix(".part")
    draft.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    draft.replace(path)
