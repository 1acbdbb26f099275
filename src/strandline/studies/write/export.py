"""The runs of a ledger as a table for other programs: CSV, or netCDF with the interfaces."""

import csv
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from strandline.foundations import whole_file
from strandline.runs import Details, Overview, Run
from strandline.studies.keys.folder import told_if_unwritable

if TYPE_CHECKING:
    import xarray as xr

    from strandline.interface import Interface


def write_csv(path: Path, runs: Sequence[Run], ledger: Overview) -> str:
    """Write a row for each run, whole or not at all; return a remark, here always empty.

    Columns: key, state, kind, seconds, message (its first line), then ``input.NAME`` and ``diagnostic.NAME``; or empty.
    """
    messages, figures = _facts(runs, ledger)
    inputs = [run.inputs for run in runs]
    names, labels = _names(inputs), _names(figures)
    heading = ["key", "state", "kind", "seconds", "message"]
    heading += [f"input.{name}" for name in names] + [f"diagnostic.{name}" for name in labels]
    with told_if_unwritable(path), whole_file(path) as part, part.open("w", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(heading)
        for run, message, given, found in zip(runs, messages, inputs, figures, strict=True):
            facts = (run.key, run.last.state, run.last.kind, run.last.seconds, message)
            table.writerow([*facts, *(given.get(name) for name in names), *(found.get(name) for name in labels)])
    return ""


def write_netcdf(path: Path, runs: Sequence[Run], ledger: Overview) -> str:
    """Write the runs with their interfaces, whole or not at all; return a remark on what was left out.

    Variables by run: state, kind, message, seconds, inputs (run, input), diagnostics (run, diagnostic) and for each
    condition the interface (run, point, xyz) in mm, NaN if the run is not ok. The interface is left out if the runs
    have different numbers of points; the cells are included if all runs have the same. Raises InvalidStudy if the file
    cannot be written, LedgerError if a stored outcome does not match its checksum.
    """
    content, missing = _dataset(runs, ledger)
    with told_if_unwritable(path), whole_file(path) as partial:
        content.to_netcdf(partial, engine="h5netcdf")
    if not missing:
        return ""
    which = ", ".join(name or "the interface" for name in missing)
    return f"; left out, as the numbers of points differ: {which}"


def _dataset(runs: Sequence[Run], ledger: Overview) -> tuple["xr.Dataset", list[str]]:
    import numpy as np
    import xarray as xr

    from strandline.foundations import __version__

    messages, figures = _facts(runs, ledger)
    seconds = [math.nan if run.last.seconds is None else run.last.seconds for run in runs]
    content = xr.Dataset(
        {
            "state": ("run", np.array([run.last.state for run in runs], dtype=object)),
            "kind": ("run", np.array([run.last.kind or "" for run in runs], dtype=object)),
            "message": ("run", np.array(messages, dtype=object)),
            "seconds": ("run", np.array(seconds, dtype=float), {"units": "s"}),
            "inputs": _by_name("input", [run.inputs for run in runs]),
        },
        coords={"run": np.array([run.key for run in runs], dtype=object)},
        attrs={"created_by": f"strandline {__version__}"},
    )
    if _names(figures):
        content["diagnostics"] = _by_name("diagnostic", figures)
    return _with_interfaces(content, runs, ledger.path)


def _by_name(dim: str, rows: Sequence[Mapping[str, float]]) -> "xr.DataArray":
    import numpy as np
    import xarray as xr

    names = _names(rows)
    values = np.array([[row.get(name, math.nan) for name in names] for row in rows], dtype=float)
    return xr.DataArray(values, dims=("run", dim), coords={dim: np.array(names, dtype=object)})


def _with_interfaces(content: "xr.Dataset", runs: Sequence[Run], ledger: Path) -> tuple["xr.Dataset", list[str]]:
    from strandline.runs import Ledger

    with Ledger.open(ledger, model=None, read_only=True) as source:
        records = source.latest(run.key for run in runs if run.last.state == "ok")
    missing = []
    for condition in dict.fromkeys(name for record in records.values() for name in record.interfaces):
        found = {key: record.interfaces[condition] for key, record in records.items() if record.ok}
        if len({interface.points.shape for interface in found.values()}) == 1:
            content = content.assign(dict(_interfaces(condition, runs, found)))
        else:
            missing.append(condition)
    return content, missing


def _interfaces(
    condition: str, runs: Sequence[Run], found: Mapping[str, "Interface"]
) -> Iterator[tuple[str, tuple[Any, ...]]]:
    import numpy as np

    end, first = f"_{condition}" if condition else "", next(iter(found.values()))
    points = np.full((len(runs), *first.points.shape), np.nan)
    for number, run in enumerate(runs):
        if run.key in found:
            points[number] = found[run.key].points
    yield f"interface{end}", (("run", f"point{end}", "xyz"), points, {"units": "mm"})
    if all(np.array_equal(interface.cells, first.cells) for interface in found.values()):
        yield f"cells{end}", ((f"cell{end}", f"corner{end}"), first.cells)


def _facts(runs: Sequence[Run], ledger: Overview) -> tuple[list[str], list[Mapping[str, float]]]:
    details, none = ledger.details(run.last.number for run in runs), Details("", "", {})
    found = [details.get(run.last.number, none) for run in runs]
    return [next(iter(one.message.splitlines()), "") for one in found], [one.diagnostics for one in found]


def _names(rows: Iterable[Mapping[str, float]]) -> list[str]:
    return list(dict.fromkeys(name for row in rows for name in row))
