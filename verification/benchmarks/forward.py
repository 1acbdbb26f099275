"""What a run of the built-in model costs, and where the time goes.

Times depend on the machine and its load. The points are the first of Sobol's sequence in the box of the study,
including failures, at V_in = 100.
"""

import os
import resource
import statistics
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import wraps
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import numpy as np

from strandline.errors import ForwardModelError, InvalidInput
from strandline.models.biofilm.cell import FlowCell, Setting
from strandline.models.biofilm.geometry import MESHES, MeshSize, Partition
from strandline.models.biofilm.linear import SOLVERS, VARIABLE, Factorisation, linear_solver
from strandline.models.biofilm.materials import LAWS
from strandline.models.biofilm.model import Biofilm
from strandline.models.biofilm.outline import Channel, Outline
from strandline.models.biofilm.system import CoupledSystem
from strandline.models.protocol import ModelInput, Simulation
from strandline.runs import LocalProcesses, RunRecord, RunRequest

E_BOX, NU_BOX, INFLOW = (100.0, 800.0), (-0.8, 0.5), 100.0
POINTS, PROFILED, WORKERS = 256, 64, 2
AIMS = {"coarse": 1100.0, "default": 400.0}
"""Solves per minute."""
PLACES = ((400.0, 0.3), (700.0, 0.0), (300.0, -0.5), (500.0, 0.499), (800.0, -0.8))
PARTS = {
    "assembly": (CoupledSystem, "factorise"),
    "factorisation": (Factorisation, "__init__"),
    "residuals": (CoupledSystem, "residual"),
    "back-substitution": (Factorisation, "solve"),
}
"""Method of each part; the time of a part is that of its method without calls of the others."""


@dataclass(frozen=True)
class Figure:
    """One line of the table; `value` is None if it could not be measured."""

    what: str
    case: str
    value: float | None
    unit: str
    remark: str = ""


@dataclass(frozen=True, eq=False)
class Pace:
    """Records of a design in the order in which they ended, and their times in seconds after the call."""

    records: list[RunRecord]
    times: list[float]

    @property
    def per_minute(self) -> float:
        """Solves per minute from the first record to the last."""
        return 60.0 * (len(self.times) - 1) / (self.times[-1] - self.times[0])

    @property
    def start_up(self) -> float:
        """Seconds until the first record: workers, mesh, first run."""
        return self.times[0]


@dataclass
class Clock:
    """Seconds of parts that call each other, without those of inner calls, and how often each was called."""

    seconds: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    calls: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    now: Callable[[], float] = time.perf_counter
    _inner: list[float] = field(default_factory=list)

    def measured(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return `function`, with its time added to `part`."""

        @wraps(function)
        def wrapped(*args: Any, **kwargs: Any) -> Any:
            self.calls[part] += 1
            self._inner.append(0.0)
            begun = self.now()
            try:
                return function(*args, **kwargs)
            finally:
                spent = self.now() - begun
                self.seconds[part] += spent - self._inner.pop()
                if self._inner:
                    self._inner[-1] += spent

        return wrapped


@dataclass(frozen=True, eq=False)
class Profile:
    """Seconds of all runs, of the failed ones, and of each part of `PARTS`; Jacobians of the runs that ended well."""

    total: float
    failed: float
    seconds: Mapping[str, float]
    calls: Mapping[str, int]
    jacobians: int
    failures: int

    @property
    def shares(self) -> dict[str, float]:
        """Shares of the parts and of the rest."""
        shares = {part: self.seconds[part] / self.total for part in PARTS}
        return shares | {"rest": 1.0 - sum(shares.values())}


@dataclass(frozen=True)
class Cost:
    """Cost of one solve on one mesh."""

    elements: int
    unknowns: int
    seconds: float


@dataclass(frozen=True)
class PeakMemory:
    """A biofilm whose runs report the peak memory of their process, in MiB."""

    model: Biofilm

    @property
    def inputs(self) -> tuple[ModelInput, ...]:
        """Inputs of the biofilm."""
        return self.model.inputs

    def __call__(self, inputs: Mapping[str, float], workdir: Path | None = None) -> Simulation:
        """Return the biofilm's run."""
        simulation = self.model(inputs, workdir)
        return replace(simulation, diagnostics={**simulation.diagnostics, "peak_MiB": peak_memory()})


def main() -> list[dict[str, Any]]:
    """Print each figure as it is measured; return them all."""
    found = []
    for figure in figures():
        found.append(asdict(figure))
        value = "-" if figure.value is None else f"{figure.value:.4g}"
        print(f"{figure.what:<42} {figure.case:<22} {value:>9} {figure.unit:<12} {figure.remark}", flush=True)
    return found


def figures() -> Iterator[Figure]:
    """Measure everything."""
    for mesh in AIMS:
        for solver in SOLVERS:
            with using(solver) as installed:
                yield from pace_figures(mesh, solver, installed=installed)
    for solver in SOLVERS:
        with using(solver) as installed:
            if installed:
                yield from profile_figures("default", solver, design(PROFILED))
    yield from cost_figures()
    yield from sensitivity_figures()
    yield from memory_figures()


def pace_figures(mesh: str, solver: str, *, installed: bool) -> Iterator[Figure]:
    """Yield solves per minute of the product's own executor, and what a failure costs."""
    case = f"{mesh}, {solver}"
    if not installed:
        yield Figure(f"solves, {WORKERS} workers", case, None, "per minute", "not installed")
        return
    measured = pace(Biofilm(mesh=mesh), design(POINTS))
    verdict = "met" if measured.per_minute >= AIMS[mesh] else "not met"
    yield Figure(
        f"solves, {WORKERS} workers", case, measured.per_minute, "per minute", f"aim {AIMS[mesh]:g}: {verdict}"
    )
    yield Figure("until the first record", case, measured.start_up, "s")
    yield from anchored_figures(mesh, case, measured)
    costs = failure_costs(measured.records)
    if costs:
        remark = f"{len(costs)} failures, of the runs after each worker's first"
        yield Figure("a failure, median", case, statistics.median(costs), "solves", remark)
        yield Figure("a failure, dearest", case, max(costs), "solves")


def anchored_figures(mesh: str, case: str, cold: Pace, *, points: int = POINTS) -> Iterator[Figure]:
    """Yield solves per minute from anchors on disk, what these cost once, and how many runs they served."""
    model = Biofilm(mesh=mesh, anchors=(("E", *E_BOX), ("nu", *NU_BOX), ("V_in", INFLOW, INFLOW)))
    with TemporaryDirectory() as folder, patch.dict(os.environ, {"XDG_CACHE_HOME": folder}):
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            yield Figure("solving the anchors, once", case, pool.submit(preparation, model).result(), "s")
        measured = pace(model, design(points))
    ratio = f"{measured.per_minute / cold.per_minute:.2f} times those without"
    yield Figure(f"runs from anchors, {WORKERS} workers", case, measured.per_minute, "per minute", ratio)
    figures = [record.diagnostics for record in measured.records if record.ok]
    served = [one for one in figures if one["anchored"]]
    kept = sum(one["newton_jacobians"] == 0 for one in served)
    yield Figure("runs without a Jacobian", case, kept, f"of {points}", f"{len(served) - kept} more from anchors")
    yield Figure("largest difference to a run without", case, 1e3 * difference(cold.records, measured.records), "µm")


def preparation(model: Biofilm) -> float:
    """Return the seconds that a model takes to prepare its runs; in a new process, which has no anchors yet."""
    begun = time.perf_counter()
    model.prepare_runs()
    return time.perf_counter() - begun


def difference(first: Sequence[RunRecord], second: Sequence[RunRecord]) -> float:
    """Return the largest distance of a point in two campaigns of equal inputs, mm; infinite if runs end otherwise."""
    other = {record.key: record for record in second}
    if any((one.state, one.failure_kind) != (other[one.key].state, other[one.key].failure_kind) for one in first):
        return float("inf")
    pairs = ((one.interfaces[name], other[one.key].interfaces[name]) for one in first for name in one.interfaces)
    return max(float(np.abs(a.points - b.points).max()) for a, b in pairs)


def profile_figures(mesh: str, solver: str, points: Sequence[tuple[float, float]]) -> Iterator[Figure]:
    """Yield the shares of the time, in this process."""
    case, measured = f"{mesh}, {solver}", profile(flow_cell(MESHES[mesh]), points)
    for part, share in measured.shares.items():
        number = f"{measured.calls[part] / len(points):.1f} calls a run" if part in measured.calls else ""
        yield Figure(f"share of {part}", case, 100 * share, "%", number)
    remark = f"{measured.failures} of {len(points)} runs"
    yield Figure("share of failed runs", case, 100 * measured.failed / measured.total, "%", remark)


def cost_figures() -> Iterator[Figure]:
    """Yield the cost of a solve on four meshes, and its exponent."""
    costs = []
    for name, size in {**MESHES, "finer": scaled(MESHES["fine"], 0.7)}.items():
        cost = solve_cost(size, repeats=3)
        costs.append(cost)
        remark = f"{cost.elements} elements, {cost.unknowns} unknowns"
        yield Figure("a solve at (400 Pa, 0.3)", f"{name}, {linear_solver()}", cost.seconds, "s", remark)
    yield Figure("exponent of seconds in unknowns", linear_solver(), exponent(costs), "1")


def sensitivity_figures() -> Iterator[Figure]:
    """Yield what three sensitivities add to a run."""
    ratios = sensitivity_ratios("default", PLACES)
    remark = f"median of {len(ratios)} places, up to {max(ratios):.2f}"
    yield Figure("a run with sensitivities", f"default, {linear_solver()}", statistics.median(ratios), "runs", remark)


def memory_figures() -> Iterator[Figure]:
    """Yield the peak memory of a worker that has made its first run."""
    for mesh in MESHES:
        (record,) = pace(PeakMemory(Biofilm(mesh=mesh)), [(400.0, 0.3)]).records
        yield Figure("peak memory of a worker", f"{mesh}, {linear_solver()}", record.diagnostics["peak_MiB"], "MiB")


@contextmanager
def using(solver: str) -> Iterator[bool]:
    """Make this process and its workers use a linear solver; yield False if it is not installed."""
    with patch.dict(os.environ, {VARIABLE: solver}):
        linear_solver.cache_clear()
        try:
            yield _installed()
        finally:
            linear_solver.cache_clear()


def _installed() -> bool:
    try:
        linear_solver()
    except InvalidInput:
        return False
    return True


def design(number: int) -> list[tuple[float, float]]:
    """Return the first points (E, nu) of Sobol's sequence in the box."""
    from scipy.stats import qmc  # not in the workers, whose memory is measured

    unit = qmc.Sobol(2, scramble=False).random(number)
    lows, highs = zip(E_BOX, NU_BOX, strict=True)
    return [(float(E), float(nu)) for E, nu in qmc.scale(unit, lows, highs)]


def pace(model: Any, points: Sequence[tuple[float, float]]) -> Pace:
    """Run `model` at `points` in worker processes."""
    requests = [RunRequest(str(k), {"E": E, "nu": nu, "V_in": INFLOW}) for k, (E, nu) in enumerate(points)]
    records, times, begun = [], [], time.perf_counter()
    for record in LocalProcesses(workers=WORKERS)(model, requests):
        records.append(record)
        times.append(time.perf_counter() - begun)
    return Pace(records, times)


def failure_costs(records: Sequence[RunRecord]) -> list[float]:
    """Return the time of each failed run over the median of successful ones, without each worker's first run.

    A worker's first run also builds its mesh.
    """
    warm = [record for record in records if int(record.key) >= WORKERS]
    typical = statistics.median(record.seconds for record in warm if record.ok)
    return [record.seconds / typical for record in warm if not record.ok]


def profile(cell: FlowCell, points: Sequence[tuple[float, float]]) -> Profile:
    """Solve at `points` and time the methods of `PARTS`."""
    clock = Clock()
    seconds, failed, jacobians = [], [], 0
    with ExitStack() as stack:
        for part, (owner, name) in PARTS.items():
            stack.enter_context(patch.object(owner, name, clock.measured(part, getattr(owner, name))))
        for E, nu in points:
            begun = time.perf_counter()
            try:
                jacobians += cell.solve(Setting([E], [nu], INFLOW)).jacobians
            except ForwardModelError:
                failed.append(time.perf_counter() - begun)
            seconds.append(time.perf_counter() - begun)
    return Profile(sum(seconds), sum(failed), dict(clock.seconds), dict(clock.calls), jacobians, len(failed))


def solve_cost(size: MeshSize, *, repeats: int) -> Cost:
    """Return the size and the median seconds of a solve at (400, 0.3), after an unmeasured one."""
    cell = flow_cell(size)
    cell.solve(Setting([400.0], [0.3], INFLOW))
    seconds = [timed(cell.solve, Setting([400.0], [0.3], INFLOW)) for _ in range(repeats)]
    return Cost(cell.mesh.ne, len(cell.system.free), statistics.median(seconds))


def exponent(costs: Sequence[Cost]) -> float:
    """Return the slope of log seconds over log unknowns."""
    unknowns, seconds = ([np.log(getattr(cost, name)) for cost in costs] for name in ("unknowns", "seconds"))
    return float(np.polyfit(unknowns, seconds, 1)[0])


def sensitivity_ratios(mesh: str, places: Sequence[tuple[float, float]], *, repeats: int = 3) -> list[float]:
    """Return the ratio of seconds of a run with and without sensitivities, timed in turns, at each place."""
    plain, asked = Biofilm(mesh=mesh), Biofilm(mesh=mesh, sensitivities=True)
    plain({"E": 400.0, "nu": 0.3, "V_in": INFLOW})
    asked({"E": 400.0, "nu": 0.3, "V_in": INFLOW})
    ratios = []
    for E, nu in places:
        inputs = {"E": E, "nu": nu, "V_in": INFLOW}
        pairs = [(timed(asked, inputs), timed(plain, inputs)) for _ in range(repeats)]
        more, less = (statistics.median(column) for column in zip(*pairs, strict=True))
        ratios.append(more / less)
    return ratios


def flow_cell(size: MeshSize) -> FlowCell:
    """Return the study's flow cell on a mesh of that size."""
    law = LAWS["saint_venant_kirchhoff"]
    return FlowCell(Outline().interface(), size, channel=Channel(), partition=Partition(), law=law)


def scaled(size: MeshSize, factor: float) -> MeshSize:
    """Return `size` with all elements `factor` times as large."""
    return MeshSize(size.far * factor, size.interface * factor, size.foot * factor, size.grading)


def peak_memory() -> float:
    """Return the peak memory of this process, MiB.

    Linux reports it since the start of the program; `getrusage` would include the process that started this one.
    """
    status = Path("/proc/self/status")
    if status.exists():
        line = next(line for line in status.read_text("ascii").splitlines() if line.startswith("VmHWM:"))
        return float(line.split()[1]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def timed(task: Callable[..., object], *arguments: object) -> float:
    """Return the seconds of a call."""
    begun = time.perf_counter()
    task(*arguments)
    return time.perf_counter() - begun
