"""Where in the study's box no steady state exists, run by run: 1024 points on two meshes, and the fold between them.

Each run is followed around its limit point (no budget). All runs are kept in ledgers in the folder output, so a second
call repeats nothing; after a change of the model, move the ledgers away. It takes about half an hour on two cores, so
`python -m verification.validation` leaves it out. With ``--publish`` the tables go into the page
docs/results/forward-model.md, their raw numbers into failure-map.json next to it, and the figure is drawn again.

Run it with:  python -m verification.validation.failure_map [--points N] [--publish]
"""

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from verification.validation.biofilm_mesh import BOX, RATE, flow_cell
from verification.validation.failure_figure import draw
from verification.validation.failure_tables import (
    band_table,
    compression_table,
    differing_table,
    evidence_table,
    failures_table,
    fold_table,
    interfaces_table,
)
from verification.validation.tables import Table, put_into_page

from strandline.design import sobol
from strandline.models.biofilm.cell import FlowCell
from strandline.models.biofilm.flow import STRESS_SCALE, VELOCITY_SCALE
from strandline.models.biofilm.geometry import MESHES
from strandline.models.biofilm.model import Biofilm
from strandline.models.protocol import ForwardModel, Simulation
from strandline.runs import Executor, Ledger, LocalProcesses, Progress, RunRecord, run_campaign

__all__ = ["FOLD_RATIOS", "FirstOrder", "Runs", "box_inputs", "critical_moduli", "survey"]

OUTPUT = Path(__file__).parent / "output"
PAGE = Path(__file__).parents[2] / "docs" / "results" / "forward-model.md"
POINTS = 1024
WORKERS = 2
PAIR = ("default", "fine")
FOLD_RATIOS = (-0.8, -0.6, -0.45, -0.3, -0.15, 0.0, 0.1, 0.2, 0.3, 0.4, 0.48, 0.5)
"""ν at which the fold is searched for; its line is the cubic spline through them."""
BRACKET = (20.0, 340.0)
WIDTH = 0.2
"""E of the fold is searched for in `BRACKET` until it is known to within `WIDTH`, all in Pa."""

Inputs = Mapping[str, float]
Search = Callable[[Sequence[Inputs]], Sequence[RunRecord]]


@dataclass(frozen=True)
class FirstOrder:
    """The largest first-order compression of the solid, by which `steady_state` chooses its path, as a diagnostic.

    Args:
        mesh: Name of the mesh.
    """

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


@dataclass(frozen=True)
class Runs:
    """Makes the runs that its ledgers lack, with one ledger per model.

    Args:
        folder: Folder of the ledgers.
        executor: Executor of the runs.
    """

    folder: Path
    executor: Executor

    def __call__(self, name: str, model: ForwardModel, inputs: Sequence[Inputs]) -> tuple[RunRecord, ...]:
        """Return the records of `model` at `inputs` from the ledger called `name`."""
        self.folder.mkdir(parents=True, exist_ok=True)
        with Ledger.open(self.folder / f"{name}.sqlite", model=model, description=name) as ledger:
            return run_campaign(model, inputs, ledger=ledger, executor=self.executor, on_record=_told(name))


def box_inputs(count: int) -> list[dict[str, float]]:
    """Return the inputs at the first points of an unscrambled Sobol sequence over the study's box."""
    low, high = np.array(BOX).T
    points = low + (high - low) * np.asarray(sobol(count, 2))
    return [{"E": float(young), "nu": float(poisson), "V_in": RATE} for young, poisson in points]


def critical_moduli(search: Search, ratios: Sequence[float]) -> Float[np.ndarray, " ratio"]:
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


@dataclass(frozen=True, eq=False)
class Survey:
    """The results of all runs.

    Args:
        records: Records of the points of the box, by mesh.
        compressions: First-order compression at the same points, by mesh.
        critical: E of the fold at `FOLD_RATIOS` (ratio,), Pa, by mesh.
    """

    records: Mapping[str, Sequence[RunRecord]]
    compressions: Mapping[str, Sequence[float]]
    critical: Mapping[str, Float[np.ndarray, " ratio"]]

    @property
    def fold(self) -> CubicSpline:
        """E of the fold on the fine mesh by ν."""
        return CubicSpline(FOLD_RATIOS, self.critical[PAIR[1]])

    def tables(self) -> list[Table]:
        """Return all tables for the page."""
        default, fine = (self.records[mesh] for mesh in PAIR)
        return [
            failures_table(self.records),
            evidence_table(self.records),
            band_table(default, fine, self.fold),
            differing_table(default, fine, self.fold),
            interfaces_table(default, fine, self.fold),
            fold_table(FOLD_RATIOS, self.critical),
            compression_table(self.records, self.compressions),
        ]


def survey(count: int, runs: Runs) -> Survey:
    """Run everything that is not in the ledgers."""
    inputs = box_inputs(count)
    models = {mesh: Biofilm(mesh=mesh, failure_budget=0) for mesh in MESHES}
    names = {mesh: f"failure-map-{mesh}" for mesh in MESHES}
    records = {mesh: runs(names[mesh], models[mesh], inputs) for mesh in PAIR}
    linear = {mesh: runs(f"first-order-{mesh}", FirstOrder(mesh), inputs) for mesh in PAIR}
    compressions = {mesh: [record.diagnostics["compression"] for record in found] for mesh, found in linear.items()}
    critical = {mesh: critical_moduli(partial(runs, names[mesh], models[mesh]), FOLD_RATIOS) for mesh in MESHES}
    return Survey(records, compressions, critical)


@cache
def _cell(mesh: str) -> FlowCell:
    return flow_cell(MESHES[mesh])


def _told(name: str) -> Callable[[RunRecord, Progress], None]:
    """Return a function that prints the progress of a campaign every 64 runs."""

    def tell(record: RunRecord, progress: Progress) -> None:
        if progress.finished % 64 == 0:
            print(f"{name}: {progress.finished} of {progress.total}, {progress.elapsed:.0f} s", flush=True)

    return tell


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m verification.validation.failure_map")
    parser.add_argument("--points", type=int, default=POINTS, help="of the Sobol sequence, for a quick try")
    parser.add_argument("--publish", action="store_true", help="put tables and figure into the documentation")
    options = parser.parse_args(arguments)
    if options.publish and options.points != POINTS:
        parser.error(f"only all {POINTS} points are published")
    return options


def main(arguments: Sequence[str], output: Path = OUTPUT) -> None:
    """Print the tables and write them to failure-map.json; see the module's docstring."""
    options = _options(arguments)
    found = survey(options.points, Runs(output, LocalProcesses(WORKERS)))
    tables = found.tables()
    for table in tables:
        print(f"## {table.title}\n\n{table.markdown()}\n")
    raw = json.dumps({table.name: table.as_json() for table in tables}, indent=1, ensure_ascii=False) + "\n"
    (output / "failure-map.json").write_text(raw, "utf-8")
    if options.publish:
        PAGE.with_name("failure-map.json").write_text(raw, "utf-8")
        PAGE.write_text(put_into_page(PAGE.read_text("utf-8"), tables), "utf-8")
    folder = PAGE.parents[1] / "figures" if options.publish else output
    draw(found.records[PAIR[0]], found.records[PAIR[1]], found.fold, folder / "forward-failures.png")


if __name__ == "__main__":
    main(sys.argv[1:])
