"""Tables of the runs in the study's box: how they ended, how two meshes differ at the same point, where the fold is."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from verification.validation.tables import Cell, Table, table

from strandline.models.biofilm.steady import DIRECT_STRAIN, SAFE_STRAIN
from strandline.runs import RunRecord

Records = Sequence[RunRecord]
Fold = Callable[[Any], Any]
"""ν → E below which there is no steady state, Pa."""

BAND = 5.0
"""Half width of the band around the fold, %, outside which two meshes have to agree."""
PROTOTYPE_FOLD = {-0.6: 83.0, -0.3: 133.0, 0.0: 197.0, 0.2: 234.0, 0.3: 250.0, 0.4: 258.0, 0.48: 256.0}
"""E of the fold by ν, Pa, from an early prototype: another program, mesh and resampling of the outline."""


def tables_of(
    records: Mapping[str, Records],
    compressions: Mapping[str, Sequence[float]],
    ratios: Sequence[float],
    critical: Mapping[str, Float[np.ndarray, " ratio"]],
    fold: Fold,
) -> list[Table]:
    """Return all tables for the page.

    Args:
        records: Records of the points of the box, on the default and on the fine mesh.
        compressions: First-order compression at the same points, by mesh.
        ratios: ν at which the fold is known.
        critical: E of the fold at these (ratio,), Pa, by mesh.
        fold: Its line on the fine mesh.
    """
    pair = (*records.values(), fold)
    return [
        failures_table(records),
        evidence_table(records),
        band_table(*pair),
        differing_table(*pair),
        interfaces_table(*pair),
        fold_table(ratios, critical),
        compression_table(records, compressions),
    ]


def failures_table(records: Mapping[str, Records]) -> Table:
    """Return how many runs ended in each way on each mesh, and their cost."""
    kinds = sorted({_kind(run) for runs in records.values() for run in runs if not run.ok})
    rows = []
    for mesh, runs in records.items():
        count = Counter(_kind(run) for run in runs)
        costs = _figures(runs, "newton_jacobians", ok=True), _figures(runs, "jacobians", ok=False)
        spent = [_of(f, x) for x in costs for f in (np.median, np.max)]
        rows.append((mesh, len(runs), count["solved"], *(count[kind] for kind in kinds), *spent))
    heading = (
        f"mesh | points {{d}} | solved {{d}} | {''.join(f'`{kind}` {{d}} | ' for kind in kinds)}"
        "Jacobians of solved runs, median {g} | largest of solved {g} "
        "| of failed runs, median {g} | largest of failed {g}"
    )
    return table("failures", "Failures over the box", heading, rows)


def evidence_table(records: Mapping[str, Records]) -> Table:
    """Return the loads of the limit points, and the smallest J of solved runs, 0 for an inverted element."""
    rows = []
    for mesh, runs in records.items():
        loads = _figures(runs, "limit_load", ok=False)
        bounds = [_of(np.min, _figures(runs, key, ok=True)) for key in ("min_J_fluid", "min_J_solid")]
        rows.append((mesh, len(loads), _of(np.min, loads), _of(np.max, loads), *bounds))
    heading = (
        "mesh | limit points {d} | smallest limit load, mm²/s {.1f} | largest, mm²/s {.2f} "
        "| smallest J fluid of solved runs {.3f} | smallest J solid of solved runs {.3f}"
    )
    return table("failure_evidence", "Limit loads, and J of solved runs", heading, rows)


def band_table(default: Records, fine: Records, fold: Fold) -> Table:
    """Return at how many points two meshes agree, and how far the others lie from the fold on the fine mesh."""
    a, b = (np.array([run.ok for run in runs]) for runs in (default, fine))
    away = distances(default, fold)
    outside, crossed = np.abs(away) > BAND, b != (away > 0)
    row = (
        *(int(some.sum()) for some in (a & b, ~a & ~b, a & ~b, ~a & b)),
        _of(np.max, np.abs(away[a != b])),
        int(((a != b) & outside).sum()),
        int((a & ~b & outside).sum()),
        _of(np.max, np.abs(away[crossed])) or 0.0,
    )
    heading = (
        "solved on both {d} | failed on both {d} | solved on default only {d} | failed on default only {d} "
        f"| those two at most so far from the fold, % {{.2f}} | of them beyond {BAND:g} % {{d}} "
        f"| solved on default only beyond {BAND:g} % {{d}} | error of the fold's line, % {{.2f}}"
    )
    return table("two_meshes", "Two meshes", heading, [row])


def differing_table(default: Records, fine: Records, fold: Fold) -> Table:
    """Return the points with different outcomes, in order of ν."""
    rows = []
    for a, b in differing(default, fine):
        young, poisson, critical = a.inputs["E"], a.inputs["nu"], float(fold(a.inputs["nu"]))
        load = (b if a.ok else a).diagnostics.get("limit_load")
        rows.append((young, poisson, _kind(a), _kind(b), load, critical, 100 * (young / critical - 1)))
    heading = (
        "E, Pa {.2f} | ν {.4f} | on default | on fine | limit load of the failed run, mm²/s {.2f} "
        "| E of the fold, Pa {.1f} | distance from the fold, % {+.2f}"
    )
    return table("different_outcomes", "Points with different outcomes", heading, rows)


def interfaces_table(default: Records, fine: Records, fold: Fold) -> Table:
    """Return how far apart the interfaces of two meshes are if both solve, with and without the band."""
    both = [(a, b) for a, b in zip(default, fine, strict=True) if a.ok and b.ok]
    apart = np.array(
        [1e3 * np.linalg.norm(a.interface.points - b.interface.points, axis=1).max() for a, b in both]
    )  # of corresponding nodes, µm
    share = 100 * apart / np.array([1e3 * b.diagnostics["max_displacement"] for _, b in both])
    outside = np.abs(distances([a for a, _ in both], fold)) > BAND
    rows = []
    for name, chosen in (("solved on both", outside | True), (f"of them beyond {BAND:g} % of the fold", outside)):
        figures = [_of(f, x[chosen]) for x in (apart, share) for f in (np.median, np.max)]
        rows.append((name, int(chosen.sum()), *figures))
    heading = "points | number {d} | median, µm {.3f} | largest, µm {.3f} | median, % {.3f} | largest, % {.3f}"
    return table("two_interfaces", "Interfaces of two meshes", heading, rows)


def fold_table(ratios: Sequence[float], critical: Mapping[str, Float[np.ndarray, " ratio"]]) -> Table:
    """Return E of the fold by ν on each mesh, and that of an early prototype."""
    rows = [
        (ratio, *map(float, values), PROTOTYPE_FOLD.get(ratio))
        for ratio, *values in sorted(zip(ratios, *critical.values(), strict=True))
    ]
    heading = f"ν {{g}} | {''.join(f'{mesh}, Pa {{.1f}} | ' for mesh in critical)}prototype, Pa {{.0f}}"
    return table("fold", "The fold", heading, rows)


def compression_table(records: Mapping[str, Records], compressions: Mapping[str, Sequence[float]]) -> Table:
    """Return the first-order compression by outcome, and the outcomes on either side of the bounds of `steady`."""
    rows = []
    for mesh, values in compressions.items():
        strain, ok = np.array(values), np.array([run.ok for run in records[mesh]])
        between = (strain > SAFE_STRAIN) & (strain <= DIRECT_STRAIN)
        ranges = (strain <= SAFE_STRAIN, between, strain > DIRECT_STRAIN)
        counts = [int((where & outcome).sum()) for where in ranges for outcome in (ok, ~ok)]
        rows.append((mesh, _of(np.max, strain[ok]), _of(np.min, strain[~ok]), *counts))
    places = (f"≤ {SAFE_STRAIN:g}", f"{SAFE_STRAIN:g} to {DIRECT_STRAIN:g}", f"> {DIRECT_STRAIN:g}")
    counted = "".join(f" | {place}: {outcome} {{d}}" for place in places for outcome in ("solved", "failed"))
    heading = f"mesh | largest of a solved run {{.3f}} | smallest of a failed run {{.3f}}{counted}"
    return table("first_order_compression", "First-order compression", heading, rows)


def differing(default: Records, fine: Records) -> list[tuple[RunRecord, RunRecord]]:
    """Return the runs on both meshes at points with different outcomes, in order of ν."""
    found = [(a, b) for a, b in zip(default, fine, strict=True) if a.ok != b.ok]
    return sorted(found, key=lambda pair: pair[0].inputs["nu"])


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
