"""Where in the study's box no steady state exists, run by run: 1024 points on two meshes, and the fold between them.

Each run is followed around its limit point (no budget). All runs are kept in ledgers in the folder output, so a second
call repeats nothing; after a change of the model, move the ledgers away. It takes about half an hour on two cores, so
`python -m verification.validation` leaves it out. With ``--publish`` the tables go into the page
docs/results/forward-model.md, their raw numbers into failure-map.json next to it, and the figure is drawn again.

Run it with:  python -m verification.validation.failure_map [--points N] [--publish]
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from scipy.interpolate import CubicSpline
from verification.validation.biofilm_mesh import BOX, RATE, box_points, flow_cell
from verification.validation.tables import DOCS, OUTPUT, Cell, Table, arguments, show, table

from strandline.models.biofilm.cells.steady import DIRECT_STRAIN, SAFE_STRAIN
from strandline.models.biofilm.equations.flow import STRESS_SCALE, VELOCITY_SCALE
from strandline.models.biofilm.mesh.geometry import MESHES
from strandline.models.biofilm.model import Biofilm
from strandline.models.protocol import ForwardModel
from strandline.report.plots.style import SKY
from strandline.runs import Ledger, LocalProcesses, Progress, RunRecord, run_campaign

Records = Sequence[RunRecord]
Fold = Callable[[Any], Any]
"""ν → E below which there is no steady state, Pa."""

BAND = 5.0
"""Half width of the band around the fold, %, outside which two meshes have to agree."""
PROTOTYPE_FOLD = {-0.6: 83.0, -0.3: 133.0, 0.0: 197.0, 0.2: 234.0, 0.3: 250.0, 0.4: 258.0, 0.48: 256.0}
"""E of the fold by ν, Pa, from an early prototype: another program, mesh and resampling of the outline."""
PAGE = DOCS / "results" / "forward-model.md"
POINTS = 1024
PAIR = ("default", "fine")
FOLD_RATIOS = (-0.8, -0.6, -0.45, -0.3, -0.15, 0.0, 0.1, 0.2, 0.3, 0.4, 0.48, 0.5)
"""ν at which the fold is searched for; its line is the cubic spline through them."""
BRACKET = (20.0, 340.0)
WIDTH = 0.2
"""E of the fold is searched for in `BRACKET` until it is known to within `WIDTH`, all in Pa."""
Inputs = Mapping[str, float]


def tables_of(
    records: Mapping[str, Records],
    compressions: Mapping[str, Sequence[float]],
    ratios: Sequence[float],
    critical: Mapping[str, Float[np.ndarray, " ratio"]],
    fold: Fold,
) -> list[Table]:
    """Return all tables for the page: of records and first-order compressions of the points of the box, by mesh.

    The fold is known at ν of `ratios`, E in Pa by mesh; `fold` is its line on the fine mesh.
    """
    pair = (*records.values(), fold)
    return [
        _failures_table(records),
        evidence_table(records),
        band_table(*pair),
        _differing_table(*pair),
        interfaces_table(*pair),
        _fold_table(ratios, critical),
        compression_table(records, compressions),
    ]


def _failures_table(records: Mapping[str, Records]) -> Table:
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


def _differing_table(default: Records, fine: Records, fold: Fold) -> Table:
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


def _fold_table(ratios: Sequence[float], critical: Mapping[str, Float[np.ndarray, " ratio"]]) -> Table:
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


def compressions_of(mesh: str, inputs: Sequence[Inputs]) -> list[float]:
    """Return the largest first-order compression of the solid, by which `steady_state` chooses its path, at inputs."""
    cell, found = flow_cell(MESHES[mesh]), []
    for one in inputs:
        cell.system.set_material([one["E"] / STRESS_SCALE], [one["nu"]])
        load = one["V_in"] / VELOCITY_SCALE
        rest = cell.undeformed(load)
        linear = rest - cell.factorise(rest, load).solve(cell.residual(rest, load))
        found.append(float(cell.largest_compression(linear)))
    return found


def made(name: str, model: ForwardModel, inputs: Sequence[Inputs]) -> tuple[RunRecord, ...]:
    """Return the records of a model from the ledger of this name; runs that it lacks are made, two at a time."""

    def tell(record: RunRecord, progress: Progress) -> None:
        if progress.finished % 64 == 0:
            print(f"{name}: {progress.finished} of {progress.total}, {progress.elapsed:.0f} s", flush=True)

    with Ledger.open(OUTPUT / f"{name}.sqlite", model=model, description=name) as ledger:
        return run_campaign(model, inputs, ledger=ledger, executor=LocalProcesses(2), on_record=tell)


def box_inputs(count: int) -> list[dict[str, float]]:
    """Return the inputs at the first points of an unscrambled Sobol sequence over the study's box."""
    points = box_points(count, scramble=None).tolist()
    return [{"E": young, "nu": poisson, "V_in": RATE} for young, poisson in points]


def critical_moduli(search: Callable[[Sequence[Inputs]], Records], ratios: Sequence[float]) -> np.ndarray:
    """Return the smallest E [Pa] with a steady state at each ν, in `BRACKET`, by bisection at all of them at once."""
    low, high = (np.full(len(ratios), end) for end in BRACKET)
    while (high - low).max() > WIDTH:
        middle = 0.5 * (low + high)
        inputs = [{"E": float(E), "nu": float(nu), "V_in": RATE} for E, nu in zip(middle, ratios, strict=True)]
        solved = np.array([record.ok for record in search(inputs)])
        low, high = np.where(solved, low, middle), np.where(solved, middle, high)
    if (low == BRACKET[0]).any() or (high == BRACKET[1]).any():
        raise ValueError(f"the fold is not between {BRACKET[0]:g} and {BRACKET[1]:g} Pa everywhere: {low} to {high}")
    return np.asarray(0.5 * (low + high))


def draw(default: Records, fine: Records, fold: Fold, path: Path) -> None:
    """Draw the outcomes on the default mesh, the fold on the fine mesh, and the points where the two meshes differ."""
    figure, axes = plt.subplots(figsize=(8, 4.8), layout="constrained")
    stalled = [run for run in default if not run.ok and "limit_load" not in run.diagnostics]
    _marks(axes, stalled, c=SKY, marker="X", s=42, label="failed, stalled")
    solved = {"cmap": "viridis", "s": 15, "label": "solved"}
    dark = ListedColormap(mpl.colormaps["Oranges"](np.linspace(0.35, 1.0, 256)))
    failed = {"cmap": dark, "marker": "X", "s": 30, "label": "failed at a limit point"}
    for quantity, factor, name, style in (
        ("max_displacement", 1e3, "largest displacement, µm", solved),
        ("limit_load", 1.0, "limit load, mm²/s", failed),
    ):
        having = [run for run in default if quantity in run.diagnostics]
        drawn = _marks(axes, having, c=[factor * run.diagnostics[quantity] for run in having], **style)
        if drawn is not None:
            figure.colorbar(drawn, ax=axes, label=name, pad=0.02, aspect=30)
    ratios = np.linspace(*BOX[1], 200)
    axes.plot(fold(ratios), ratios, "k-", lw=1.4, label="fold, mesh fine")
    if pairs := differing(default, fine):
        circle = {"s": 80, "facecolors": "none", "edgecolors": "k", "lw": 1.1, "clip_on": True}
        _marks(axes, [a for a, _ in pairs], label="solved on one mesh only", **circle)
    axes.set(xlim=BOX[0], ylim=BOX[1], xlabel="E, Pa", ylabel="ν")
    figure.legend(loc="outside upper center", ncols=5, frameon=False, fontsize="small", columnspacing=1.2)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _marks(ax: Axes, runs: Records, **style: Any) -> Any:
    """Draw a mark at each run; return None if there are none."""
    if not runs:
        return None
    places = np.array([(run.inputs["E"], run.inputs["nu"]) for run in runs])
    return ax.scatter(places[:, 0], places[:, 1], **{"lw": 0, "clip_on": False, **style})


def main() -> None:
    """Print the tables and write them to failure-map.json; see the module's docstring."""
    options = arguments(__doc__, points=POINTS, publish=False)
    if options.publish and options.points != POINTS:
        raise SystemExit(f"only all {POINTS} points are published")
    OUTPUT.mkdir(exist_ok=True)
    inputs = box_inputs(options.points)
    models = {mesh: Biofilm(mesh=mesh, failure_budget=0) for mesh in MESHES}
    search = {mesh: partial(made, f"failure-map-{mesh}", model) for mesh, model in models.items()}
    records = {mesh: search[mesh](inputs) for mesh in PAIR}
    compressions = {mesh: compressions_of(mesh, inputs) for mesh in PAIR}
    critical = {mesh: critical_moduli(search[mesh], FOLD_RATIOS) for mesh in MESHES}
    fold = CubicSpline(FOLD_RATIOS, critical["fine"])
    tables = tables_of(records, compressions, FOLD_RATIOS, critical, fold)
    show(tables, page=PAGE if options.publish else None, numbers="failure-map.json")
    draw(*records.values(), fold, (DOCS / "figures" if options.publish else OUTPUT) / "forward-failures.png")


if __name__ == "__main__":
    main()
