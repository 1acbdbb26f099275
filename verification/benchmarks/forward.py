"""What a run of the built-in model costs, and where the time goes.

Times depend on the machine and its load. The points are the first of Sobol's sequence in the box of the study,
including failures, at V_in = 100.
"""

import os
import statistics
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import wraps
from multiprocessing import get_context
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import numpy as np
from verification.benchmarks.figures import Figure, peak_memory, timed
from verification.validation.biofilm_mesh import BOX, box_points, flow_cell
from verification.validation.biofilm_mesh import RATE as INFLOW
from verification.validation.generality import cost

from strandline.foundations import ForwardModelError, InvalidInput
from strandline.models.biofilm.cells.cell import Setting
from strandline.models.biofilm.equations.system import CoupledSystem
from strandline.models.biofilm.linear import SOLVERS, VARIABLE, Factorisation, linear_solver
from strandline.models.biofilm.mesh.geometry import MESHES, MeshSize
from strandline.models.biofilm.model import Biofilm
from strandline.runs import LocalProcesses, RunRecord, RunRequest

POINTS, PROFILED, WORKERS, REPEATS = 256, 64, 2, 3
PLACES = ((400.0, 0.3), (700.0, 0.0), (300.0, -0.5), (500.0, 0.499), (800.0, -0.8))
PARTS = {
    "assembly": (CoupledSystem, "factorise"),
    "factorisation": (Factorisation, "__init__"),
    "residuals": (CoupledSystem, "residual"),
    "back-substitution": (Factorisation, "solve"),
}
"""Method of each part; the time of a part is that of its method without calls of the others."""

Points = Sequence[tuple[float, float]]


def figures() -> Iterator[Figure]:
    """Measure everything."""
    for mesh in ("coarse", "default"):
        for solver in SOLVERS:
            with using(solver) as installed:
                yield from pace_figures(mesh, solver, installed=installed)
    for solver in SOLVERS:
        with using(solver) as installed:
            if installed:
                yield from profile_figures("default", solver, box_points(PROFILED, scramble=None).tolist())
    yield from cost_figures()
    yield sensitivity_figure("default", PLACES)
    for mesh in MESHES:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            peak = pool.submit(peak_of_a_run, mesh).result()
        yield Figure("peak memory of a worker", f"{mesh}, {linear_solver()}", peak, "MiB")


@dataclass(frozen=True, eq=False)
class Pace:
    """Records of a design in the order in which they ended, and their times in seconds after the call."""

    records: list[RunRecord]
    times: list[float]

    @property
    def per_minute(self) -> float:
        """Solves per minute from the first record to the last."""
        return 60.0 * (len(self.times) - 1) / (self.times[-1] - self.times[0])


def pace(model: Any, points: Points) -> Pace:
    """Run `model` at `points` in worker processes."""
    requests = [RunRequest(str(k), {"E": E, "nu": nu, "V_in": INFLOW}) for k, (E, nu) in enumerate(points)]
    records, times, begun = [], [], time.perf_counter()
    for record in LocalProcesses(workers=WORKERS)(model, requests):
        records.append(record)
        times.append(time.perf_counter() - begun)
    return Pace(records, times)


def pace_figures(mesh: str, solver: str, *, installed: bool = True, points: int = POINTS) -> Iterator[Figure]:
    """Yield solves per minute of the product's own executor, and what a failure costs."""
    case, what = f"{mesh}, {solver}", f"solves, {WORKERS} workers"
    if not installed:
        yield Figure(what, case, None, "per minute", "not installed")
        return
    measured = pace(Biofilm(mesh=mesh), box_points(points, scramble=None).tolist())
    yield Figure(what, case, measured.per_minute, "per minute")
    yield Figure("until the first record", case, measured.times[0], "s")  # workers, mesh, first run
    yield from anchored_figures(mesh, case, measured)
    warm = [record for record in measured.records if int(record.key) >= WORKERS]
    typical = statistics.median(record.seconds for record in warm if record.ok)
    costs = [record.seconds / typical for record in warm if not record.ok]
    if costs:
        remark = f"{len(costs)} failures, of the runs after each worker's first"
        yield Figure("a failure, median", case, statistics.median(costs), "solves", remark)
        yield Figure("a failure, dearest", case, max(costs), "solves")


def anchored_figures(mesh: str, case: str, cold: Pace) -> Iterator[Figure]:
    """Yield solves per minute from anchors on disk, what these cost once, and how many runs they served."""
    model, points = Biofilm(mesh=mesh, anchors=(("E", *BOX[0]), ("nu", *BOX[1]), ("V_in", INFLOW, INFLOW))), cold.times
    with TemporaryDirectory() as folder, patch.dict(os.environ, {"XDG_CACHE_HOME": folder}):
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:  # it has no anchors yet
            yield Figure("solving the anchors, once", case, pool.submit(timed, model.prepare_runs).result(), "s")
        measured = pace(model, box_points(len(points), scramble=None).tolist())
    ratio = f"{measured.per_minute / cold.per_minute:.2f} times those without"
    yield Figure(f"runs from anchors, {WORKERS} workers", case, measured.per_minute, "per minute", ratio)
    served = [one for one in (record.diagnostics for record in measured.records if record.ok) if one["anchored"]]
    kept = sum(one["newton_jacobians"] == 0 for one in served)
    more = f"{len(served) - kept} more from anchors"
    yield Figure("runs without a Jacobian", case, kept, f"of {len(points)}", more)
    yield Figure("largest difference to a run without", case, 1e3 * difference(cold.records, measured.records), "µm")


def difference(first: Sequence[RunRecord], second: Sequence[RunRecord]) -> float:
    """Return the largest distance of a point in two campaigns of equal inputs, mm; infinite if runs end otherwise."""
    other = {record.key: record for record in second}
    if any((one.state, one.failure_kind) != (other[one.key].state, other[one.key].failure_kind) for one in first):
        return float("inf")
    pairs = ((one.interfaces[name], other[one.key].interfaces[name]) for one in first for name in one.interfaces)
    return max(float(np.abs(a.points - b.points).max()) for a, b in pairs)


@dataclass
class Clock:
    """Seconds of parts that call each other, without those of inner calls, and how often each was called."""

    seconds: Counter[str] = field(default_factory=Counter)
    calls: Counter[str] = field(default_factory=Counter)
    _inner: list[float] = field(default_factory=list)

    def measured(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return `function`, with its time added to `part`."""

        @wraps(function)
        def wrapped(*args: Any, **kwargs: Any) -> Any:
            self.calls[part] += 1
            self._inner.append(0.0)
            begun = time.perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                spent = time.perf_counter() - begun
                self.seconds[part] += spent - self._inner.pop()
                if self._inner:
                    self._inner[-1] += spent

        return wrapped


def profile_figures(mesh: str, solver: str, points: Points) -> Iterator[Figure]:
    """Yield the shares of the time that the methods of `PARTS` and failed runs take, in this process."""
    cell, case, clock = flow_cell(MESHES[mesh]), f"{mesh}, {solver}", Clock()
    seconds, failed = [], []
    with ExitStack() as stack:
        for part, (owner, name) in PARTS.items():
            stack.enter_context(patch.object(owner, name, clock.measured(part, getattr(owner, name))))
        for E, nu in points:
            begun, ended_well = time.perf_counter(), True
            try:
                cell.solve(Setting([E], [nu], INFLOW))
            except ForwardModelError:
                ended_well = False
            seconds.append(time.perf_counter() - begun)
            failed += [] if ended_well else seconds[-1:]
    shares = {part: clock.seconds[part] / sum(seconds) for part in PARTS}
    for part, share in (shares | {"rest": 1.0 - sum(shares.values())}).items():
        number = f"{clock.calls[part] / len(points):.1f} calls a run" if part in clock.calls else ""
        yield Figure(f"share of {part}", case, 100 * share, "%", number)
    remark = f"{len(failed)} of {len(points)} runs"
    yield Figure("share of failed runs", case, 100 * sum(failed) / sum(seconds), "%", remark)


def cost_figures() -> Iterator[Figure]:
    """Yield the median seconds of a solve on four meshes, after an unmeasured one, and their exponent."""
    fine, where = MESHES["fine"], Setting([400.0], [0.3], INFLOW)
    finer = MeshSize(fine.far * 0.7, fine.interface * 0.7, fine.foot * 0.7, fine.grading)
    sizes, costs = [], []
    for name, size in {**MESHES, "finer": finer}.items():
        cell = flow_cell(size)
        cell.solve(where)
        costs.append(statistics.median(timed(cell.solve, where) for _ in range(REPEATS)))
        sizes.append(len(cell.system.free))
        remark = f"{cell.mesh.ne} elements, {sizes[-1]} unknowns"
        yield Figure("a solve at (400 Pa, 0.3)", f"{name}, {linear_solver()}", costs[-1], "s", remark)
    exponent = float(np.polyfit(np.log(sizes), np.log(costs), 1)[0])
    yield Figure("exponent of seconds in unknowns", linear_solver(), exponent, "1")


def sensitivity_figure(mesh: str, places: Points) -> Figure:
    """Return the ratio of seconds of a run with and without three sensitivities, timed in turns at each place."""
    model, first = Biofilm(mesh=mesh), {"E": 400.0, "nu": 0.3, "V_in": INFLOW}
    cost(model, first, repeats=1)  # makes the mesh
    ratios = [1.0 + cost(model, {"E": E, "nu": nu, "V_in": INFLOW}, repeats=REPEATS) for E, nu in places]
    remark = f"median of {len(ratios)} places, up to {max(ratios):.2f}"
    return Figure("a run with sensitivities", f"{mesh}, {linear_solver()}", statistics.median(ratios), "runs", remark)


@contextmanager
def using(solver: str) -> Iterator[bool]:
    """Make this process and its workers use a linear solver; yield False if it is not installed."""
    with patch.dict(os.environ, {VARIABLE: solver}):
        linear_solver.cache_clear()
        try:
            linear_solver()
            installed = True
        except InvalidInput:
            installed = False
        try:
            yield installed
        finally:
            linear_solver.cache_clear()


def peak_of_a_run(mesh: str) -> float:
    """Return the peak memory of this process after a run, MiB."""
    Biofilm(mesh=mesh)({"E": 400.0, "nu": 0.3, "V_in": INFLOW})
    return peak_memory()
