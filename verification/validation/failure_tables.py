"""Tables of the runs in the study's box: how they ended, how two meshes differ at the same point, where the fold is."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from verification.validation.tables import Cell, Table

from strandline.models.biofilm.steady import DIRECT_STRAIN, SAFE_STRAIN
from strandline.runs import RunRecord

__all__ = [
    "BAND",
    "band_table",
    "compression_table",
    "differing",
    "differing_table",
    "distances",
    "evidence_table",
    "failures_table",
    "fold_table",
    "interfaces_table",
]

Records = Sequence[RunRecord]
Fold = Callable[[Any], Any]
"""ν → E below which there is no steady state, Pa."""

BAND = 5.0
"""Half width of the band around the fold, %, outside which two meshes have to agree."""
PROTOTYPE_FOLD = {-0.6: 83.0, -0.3: 133.0, 0.0: 197.0, 0.2: 234.0, 0.3: 250.0, 0.4: 258.0, 0.48: 256.0}
"""E of the fold by ν, Pa, from an early prototype: another program, mesh and resampling of the outline."""


def failures_table(records: Mapping[str, Records]) -> Table:
    """Return how many runs ended in each way on each mesh, and their cost."""
    kinds = sorted({_kind(run) for runs in records.values() for run in runs if not run.ok})
    rows = []
    for mesh, runs in records.items():
        count = Counter(_kind(run) for run in runs)
        solved = _figures(runs, "newton_jacobians", ok=True)
        failed = _figures(runs, "jacobians", ok=False)
        costs = [figure for x in (solved, failed) for figure in (_of(np.median, x), _of(np.max, x))]
        rows.append((mesh, len(runs), count["solved"], *(count[kind] for kind in kinds), *costs))
    columns = (
        "mesh", "points", "solved", *(f"`{kind}`" for kind in kinds),
        "Jacobians of solved runs, median", "largest of solved", "of failed runs, median", "largest of failed",
    )  # fmt: skip
    formats = ("s", "d", "d", *("d" for _ in kinds), "g", "g", "g", "g")
    return Table("failures", "Failures over the box", columns, formats, tuple(rows))


def evidence_table(records: Mapping[str, Records]) -> Table:
    """Return the loads of the limit points, and the smallest J of solved runs, 0 for an inverted element."""
    rows = []
    for mesh, runs in records.items():
        loads = _figures(runs, "limit_load", ok=False)
        bounds = [_of(np.min, _figures(runs, key, ok=True)) for key in ("min_J_fluid", "min_J_solid")]
        rows.append((mesh, len(loads), _of(np.min, loads), _of(np.max, loads), *bounds))
    columns = (
        "mesh", "limit points", "smallest limit load, mm²/s", "largest, mm²/s",
        "smallest J fluid of solved runs", "smallest J solid of solved runs",
    )  # fmt: skip
    formats = ("s", "d", ".1f", ".2f", ".3f", ".3f")
    return Table("failure_evidence", "Limit loads, and J of solved runs", columns, formats, tuple(rows))


def band_table(default: Records, fine: Records, fold: Fold) -> Table:
    """Return at how many points two meshes agree, and how far the others lie from the fold on the fine mesh."""
    count = Counter((a.ok, b.ok) for a, b in zip(default, fine, strict=True))
    away = distances(default, fold)
    differ = np.array([a.ok != b.ok for a, b in zip(default, fine, strict=True)])
    wrong = np.array([a.ok and not b.ok for a, b in zip(default, fine, strict=True)])
    outside = np.abs(away) > BAND
    crossed = np.array([b.ok for b in fine]) != (away > 0)
    row = (
        *(count[key] for key in ((True, True), (False, False), (True, False), (False, True))),
        _of(np.max, np.abs(away[differ])),
        int((differ & outside).sum()),
        int((wrong & outside).sum()),
        _of(np.max, np.abs(away[crossed])) or 0.0,
    )
    columns = (
        "solved on both", "failed on both", "solved on default only", "failed on default only",
        "those two at most so far from the fold, %", f"of them beyond {BAND:g} %",
        f"solved on default only beyond {BAND:g} %", "error of the fold's line, %",
    )  # fmt: skip
    return Table("two_meshes", "Two meshes", columns, ("d", "d", "d", "d", ".2f", "d", "d", ".2f"), (row,))


def differing_table(default: Records, fine: Records, fold: Fold) -> Table:
    """Return the points with different outcomes, in order of ν."""
    rows = []
    for case in differing(default, fine):
        young, poisson = case.point
        critical = float(fold(poisson))
        rows.append((young, poisson, case.default, case.fine, case.limit_load, critical, 100 * (young / critical - 1)))
    columns = (
        "E, Pa", "ν", "on default", "on fine", "limit load of the failed run, mm²/s",
        "E of the fold, Pa", "distance from the fold, %",
    )  # fmt: skip
    formats = (".2f", ".4f", "s", "s", ".2f", ".1f", "+.2f")
    return Table("different_outcomes", "Points with different outcomes", columns, formats, tuple(rows))


def interfaces_table(default: Records, fine: Records, fold: Fold) -> Table:
    """Return how far apart the interfaces of two meshes are if both solve, with and without the band."""
    both = np.array([a.ok and b.ok for a, b in zip(default, fine, strict=True)])
    apart = np.array([_apart(a, b) for a, b in zip(default, fine, strict=True) if a.ok and b.ok])
    share = 100 * apart / np.array([1e3 * b.diagnostics["max_displacement"] for b in np.array(fine, object)[both]])
    outside = np.abs(distances(default, fold))[both] > BAND
    rows = []
    for name, chosen in (("solved on both", outside | True), (f"of them beyond {BAND:g} % of the fold", outside)):
        figures = [_of(f, x[chosen]) for x in (apart, share) for f in (np.median, np.max)]
        rows.append((name, int(chosen.sum()), *figures))
    columns = ("points", "number", "median, µm", "largest, µm", "median, %", "largest, %")
    return Table(
        "two_interfaces", "Interfaces of two meshes", columns, ("s", "d", ".3f", ".3f", ".3f", ".3f"), tuple(rows)
    )


def fold_table(ratios: Sequence[float], critical: Mapping[str, Float[np.ndarray, " ratio"]]) -> Table:
    """Return E of the fold by ν on each mesh, and that of an early prototype."""
    at = {ratio: k for k, ratio in enumerate(ratios)}
    rows = tuple(
        (ratio, *(float(values[k]) for values in critical.values()), PROTOTYPE_FOLD.get(ratio))
        for ratio, k in sorted(at.items())
    )
    columns = ("ν", *(f"{mesh}, Pa" for mesh in critical), "prototype, Pa")
    return Table("fold", "The fold", columns, ("g", *(".1f" for _ in critical), ".0f"), rows)


def compression_table(records: Mapping[str, Records], compressions: Mapping[str, Sequence[float]]) -> Table:
    """Return the first-order compression by outcome, and the outcomes on either side of the bounds of `steady`."""
    rows = []
    for mesh, values in compressions.items():
        strain, ok = np.array(values), np.array([run.ok for run in records[mesh]])
        between = (strain > SAFE_STRAIN) & (strain <= DIRECT_STRAIN)
        counts = [
            int((where & outcome).sum())
            for where in (strain <= SAFE_STRAIN, between, strain > DIRECT_STRAIN)
            for outcome in (ok, ~ok)
        ]
        rows.append((mesh, _of(np.max, strain[ok]), _of(np.min, strain[~ok]), *counts))
    places = (f"≤ {SAFE_STRAIN:g}", f"{SAFE_STRAIN:g} to {DIRECT_STRAIN:g}", f"> {DIRECT_STRAIN:g}")
    columns = (
        "mesh", "largest of a solved run", "smallest of a failed run",
        *(f"{place}: {outcome}" for place in places for outcome in ("solved", "failed")),
    )  # fmt: skip
    formats = ("s", ".3f", ".3f", *("d" for _ in range(6)))
    return Table("first_order_compression", "First-order compression", columns, formats, tuple(rows))


@dataclass(frozen=True)
class Differing:
    """A point with a steady state on one mesh only; outcomes are ``solved`` or the kind of failure."""

    point: tuple[float, float]
    default: str
    fine: str
    limit_load: float | None


def differing(default: Records, fine: Records) -> list[Differing]:
    """Return the points with different outcomes, in order of ν."""
    found = []
    for a, b in zip(default, fine, strict=True):
        if a.ok != b.ok:
            failed = b if a.ok else a
            point = (a.inputs["E"], a.inputs["nu"])
            found.append(Differing(point, _kind(a), _kind(b), failed.diagnostics.get("limit_load")))
    return sorted(found, key=lambda case: case.point[1])


def distances(runs: Records, fold: Fold) -> Float[np.ndarray, " run"]:
    """Return E of each run relative to E of the fold, minus 1, %."""
    young, poisson = np.array([(run.inputs["E"], run.inputs["nu"]) for run in runs]).T
    return np.asarray(100 * (young / fold(poisson) - 1))


def _kind(run: RunRecord) -> str:
    return "solved" if run.ok else str(run.failure_kind)


def _figures(runs: Records, key: str, *, ok: bool) -> Float[np.ndarray, " run"]:
    """Return a diagnostic of the runs, successful or not as `ok` says, that have it."""
    return np.array([run.diagnostics[key] for run in runs if run.ok == ok and key in run.diagnostics])


def _of(function: Callable[[Float[np.ndarray, " run"]], float], values: Float[np.ndarray, " run"]) -> Cell:
    """Return a function of some values; None if there are none."""
    return float(function(values)) if len(values) else None


def _apart(a: RunRecord, b: RunRecord) -> float:
    """Return the largest distance between corresponding nodes of two interfaces, µm."""
    if a.interface is None or b.interface is None:
        raise ValueError("a run without an interface")
    return float(1e3 * np.linalg.norm(a.interface.points - b.interface.points, axis=1).max())
