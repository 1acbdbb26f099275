"""Where in the study's box no steady state exists, run by run: 1024 points on two meshes, and the fold between them.

Each run is followed around its limit point (no budget). All runs are kept in ledgers in the folder output, so a second
call repeats nothing; after a change of the model, move the ledgers away. It takes about half an hour on two cores, so
`python -m verification.validation` leaves it out. With ``--publish`` the tables go into the page
docs/results/forward-model.md, their raw numbers into failure-map.json next to it, and the figure is drawn again.

Run it with:  python -m verification.validation.failure_map [--points N] [--publish]
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from scipy.interpolate import CubicSpline
from verification.validation.biofilm_mesh import BOX, RATE, flow_cell
from verification.validation.failure_tables import Fold, Records, differing, tables_of
from verification.validation.tables import DOCS, OUTPUT, arguments, as_text, show

from strandline.design import sobol
from strandline.models.biofilm.cell import FlowCell
from strandline.models.biofilm.flow import STRESS_SCALE, VELOCITY_SCALE
from strandline.models.biofilm.geometry import MESHES
from strandline.models.biofilm.model import Biofilm
from strandline.models.protocol import ForwardModel, Simulation
from strandline.report.plots.style import SKY
from strandline.runs import Ledger, LocalProcesses, Progress, RunRecord, run_campaign

PAGE = DOCS / "results" / "forward-model.md"
POINTS = 1024
PAIR = ("default", "fine")
FOLD_RATIOS = (-0.8, -0.6, -0.45, -0.3, -0.15, 0.0, 0.1, 0.2, 0.3, 0.4, 0.48, 0.5)
"""ν at which the fold is searched for; its line is the cubic spline through them."""
BRACKET = (20.0, 340.0)
WIDTH = 0.2
"""E of the fold is searched for in `BRACKET` until it is known to within `WIDTH`, all in Pa."""

Inputs = Mapping[str, float]


@dataclass(frozen=True)
class FirstOrder:
    """The largest first-order compression of the solid, by which `steady_state` chooses its path, as a diagnostic."""

    mesh: str

    @property
    def fingerprint(self) -> str:
        """The model's identity in a ledger."""
        return f"first-order compression:{Biofilm(mesh=self.mesh).fingerprint}"

    def __call__(self, inputs: Inputs, workdir: Path | None = None) -> Simulation:
        """Return the undeformed interface and the compression at E [Pa], nu and V_in [mm²/s]."""
        cell = _cell(self.mesh)
        cell.system.set_material([inputs["E"] / STRESS_SCALE], [inputs["nu"]])
        load = inputs["V_in"] / VELOCITY_SCALE
        rest = cell.undeformed(load)
        linear = rest - cell.factorise(rest, load).solve(cell.residual(rest, load))
        return Simulation.of(cell.outline, {"compression": cell.largest_compression(linear)})


@cache
def _cell(mesh: str) -> FlowCell:
    return flow_cell(MESHES[mesh])


def made(name: str, model: ForwardModel, inputs: Sequence[Inputs]) -> tuple[RunRecord, ...]:
    """Return the records of a model from the ledger of this name; runs that it lacks are made, two at a time."""

    def tell(record: RunRecord, progress: Progress) -> None:
        if progress.finished % 64 == 0:
            print(f"{name}: {progress.finished} of {progress.total}, {progress.elapsed:.0f} s", flush=True)

    with Ledger.open(OUTPUT / f"{name}.sqlite", model=model, description=name) as ledger:
        return run_campaign(model, inputs, ledger=ledger, executor=LocalProcesses(2), on_record=tell)


def box_inputs(count: int) -> list[dict[str, float]]:
    """Return the inputs at the first points of an unscrambled Sobol sequence over the study's box."""
    low, high = np.array(BOX).T
    points = low + (high - low) * np.asarray(sobol(count, 2))
    return [{"E": float(young), "nu": float(poisson), "V_in": RATE} for young, poisson in points]


def critical_moduli(search: Callable[[Sequence[Inputs]], Records], ratios: Sequence[float]) -> np.ndarray:
    """Return the smallest E [Pa] with a steady state at each ν, by bisection at all of them at once.

    Raises:
        ValueError: The fold does not lie inside `BRACKET`.
    """
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
    linear = {mesh: made(f"first-order-{mesh}", FirstOrder(mesh), inputs) for mesh in PAIR}
    compressions = {mesh: [record.diagnostics["compression"] for record in found] for mesh, found in linear.items()}
    critical = {mesh: critical_moduli(search[mesh], FOLD_RATIOS) for mesh in MESHES}
    fold = CubicSpline(FOLD_RATIOS, critical["fine"])
    tables = tables_of(records, compressions, FOLD_RATIOS, critical, fold)
    show(tables, page=PAGE if options.publish else None)
    (OUTPUT / "failure-map.json").write_text(as_text(tables), "utf-8")
    if options.publish:
        PAGE.with_name("failure-map.json").write_text(as_text(tables), "utf-8")
    draw(*records.values(), fold, (DOCS / "figures" if options.publish else OUTPUT) / "forward-failures.png")


if __name__ == "__main__":
    main()
