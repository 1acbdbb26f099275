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

from verification.benchmarks.aims import AIMS, LEAST, MOST, Aim, aim_of

HERE = Path(__file__).parent
RESULTS, MACHINE, SCALING = (HERE / f"{name}.json" for name in ("results", "machine", "scaling"))
PACKAGES = ("strandline", "numpy", "scipy", "jax", "jaxlib", "scikit-learn", "blackjax", "ngsolve", "mkl")
MISSING = "not measured: there is no such figure"

Record = dict[str, Any]


def save(part: str, found: Sequence[Mapping[str, Any]], *, parts: Sequence[str], results: Path = RESULTS) -> None:
    """Replace the figures of a part in the list, which is in the order of `parts`."""
    known = [record for record in load(results) if record["part"] in parts and not is_missing(record)]
    kept = [record for record in known if record["part"] != part] + [judged(one, part) for one in found]
    kept += [placeholder(aim) for aim in AIMS if aim.part in parts and not any(aim_of(one) is aim for one in kept)]
    kept.sort(key=lambda record: parts.index(record["part"]))
    write(results, kept)


def load(results: Path = RESULTS) -> list[Record]:
    """Return the figures of all parts."""
    return json.loads(results.read_text("utf-8")) if results.exists() else []


def judged(found: Mapping[str, Any], part: str, aims: Sequence[Aim] = AIMS) -> Record:
    """Return a figure or comparison as a record of the list, with its aim."""
    record = {"what": found["what"], **figures_of(found), "part": part}
    record |= {key: found[key] for key in ("case", "peer_name", "repeats") if found.get(key)}
    record["remark"] = remark_of(found, measured=record["ours"] is not None)
    aim = aim_of(record, aims)
    bound = {"aim": aim.bound, "met": aim.met(record), "aim_kind": aim.kind} if aim else {"aim": None, "met": None}
    order = ("what", "ours", "peer", "ratio", *bound)
    return {key: (record | bound)[key] for key in (*order, *(key for key in record if key not in order))}


def figures_of(found: Mapping[str, Any]) -> Record:
    """Return ours, peer, ratio, unit and, if known, the seconds of all cores and their ratio.

    Seconds are of the whole task or, if the part gives the number of evaluations, of one evaluation, whichever has the
    ratio that the part gives.
    """
    ours, peer, ratio = found.get("ours", found.get("value")), found.get("peer"), found.get("ratio")
    if isinstance(ours, Mapping) and isinstance(peer, Mapping):
        each = not math.isclose(peer["wall"] / ours["wall"], found["ratio"], rel_tol=1e-6)
        numbers = [cost["evaluations"] if each else 1 for cost in (ours, peer)]
        seconds = [[cost[key] / n for key in ("wall", "cpu")] for cost, n in zip((ours, peer), numbers, strict=True)]
        cores = {"cpu_ours": seconds[0][1], "cpu_peer": seconds[1][1], "ratio_per_core": found["cpu_ratio"]}
        unit = "s per evaluation" if each else "s"
        return {"ours": seconds[0][0], "peer": seconds[1][0], "ratio": ratio, "unit": unit, **cores}
    record: Record = {"ours": ours, "peer": peer, "ratio": ratio, "unit": found.get("unit", "s")}
    if found.get("cpu_ours"):
        cpu = found["cpu_ours"], found["cpu_peer"]
        record |= {"cpu_ours": cpu[0], "cpu_peer": cpu[1], "ratio_per_core": cpu[1] / cpu[0]}
    return record


def remark_of(found: Mapping[str, Any], *, measured: bool) -> str:
    said = str(found.get("remark", ""))
    return said if measured or said.startswith("not measured") else f"not measured: {said}"


def placeholder(aim: Aim) -> Record:
    """Return the line for an aim without a figure."""
    nothing: Record = {"what": aim.name, "ours": None, "peer": None, "ratio": None}
    unit = {"unit": aim.of} if aim.kind in (MOST, LEAST) else {}
    return nothing | {"aim": aim.bound, "met": None, "aim_kind": aim.kind, "part": aim.part, **unit, "remark": MISSING}


def is_missing(record: Mapping[str, Any]) -> bool:
    return bool(record["remark"] == MISSING)


def note_run(part: str, *, seconds: float, load_average: float | None, machine: Path = MACHINE) -> None:
    """Note when a part was run, and keep the notes of other parts from the same machine with the same packages."""
    runs = json.loads(machine.read_text("utf-8"))["runs"] if from_this_machine(machine) else {}
    date = datetime.now(UTC).isoformat(timespec="minutes")
    runs[part] = {"date": date, "seconds": round(seconds, 1), "load_average_before": load_average}
    write(machine, {**this_machine(), "runs": runs})


def from_this_machine(machine: Path = MACHINE) -> bool:
    """Return whether the known figures were measured on this machine with these packages."""
    known = json.loads(machine.read_text("utf-8")) if machine.exists() else {}
    return all(known.get(key) == value for key, value in this_machine().items())


def forget() -> None:
    """Remove all results."""
    for path in (RESULTS, MACHINE, SCALING):
        path.unlink(missing_ok=True)


def this_machine() -> dict[str, Any]:
    """Return a description of the machine and the packages, which times depend on."""
    return {
        "cpu": cpu_model(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "unset"),
        "python": platform.python_version(),
        "versions": {name: version for name in PACKAGES if (version := installed(name))},
    }


def cpu_model() -> str:
    described = Path("/proc/cpuinfo")
    found = re.search(r"model name\s*:\s*(.+)", described.read_text("utf-8")) if described.exists() else None
    return found[1] if found else platform.processor() or "unknown"


def load_average() -> float | None:
    """Return the mean number of processes that needed a core during the last minute, if the system reports it."""
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None


def installed(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def write(path: Path, content: object) -> None:
    """Write JSON in one piece."""
    draft = path.with_suffix(".part")
    draft.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    draft.replace(path)
