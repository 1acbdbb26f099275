"""Turek and Hron's benchmarks CFD3, CSM3 and FSI3, which change with time, with the system of the biofilm model.

Reference: Turek and Hron, Proposal for numerical benchmarking of fluid–structure interaction between an elastic object
and laminar incompressible flow, in: Fluid–Structure Interaction, LNCSE 53 (2006), tables for the three; for FSI3 the
later values of the same group, on the pages of Featflow (level 4, steps of 0.00025 s), which supersede the paper's.

SI units. A value is mean ± amplitude [frequency, Hz]; mean and amplitude are those of the extremes in the last period
of the whole motion, in which a force along the flow has two unequal peaks.

Run it with:  python -m verification.validation.turek_hron_time [CSM3 | CFD3 | FSI3]
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from verification.validation.tables import Table, arguments, show, table
from verification.validation.turek_hron import COARSEST, DENSITY, POISSON, Benchmark, Size, norm_weights, set_inflow

from strandline.models.biofilm.cells.transient import March, StepSettings
from strandline.models.biofilm.equations.moving import Moment, MovingSystem
from strandline.models.biofilm.newton import NewtonSettings

RAMP = 2.0
WAKE = Size(far=0.035, near=0.007, corner=0.004)
MESHES = ((COARSEST, 0), (COARSEST, 1), (COARSEST, 2), (WAKE, 0))
"""Element sizes, and how often all elements are quartered; the last mesh is finer in the wake."""


@dataclass(frozen=True)
class Stage:
    """A stretch of a run on one mesh of `MESHES` with one step, s, until a time, s; the table shows its last period."""

    level: int
    step: float
    end: float
    shown: bool = True


@dataclass(frozen=True)
class Case(Benchmark):
    """A benchmark whose published values are mean, amplitude and frequency (Hz), and its runs.

    Each run is a list of stages that go on from one another.
    """

    runs: tuple[tuple[Stage, ...], ...] = ()


SHEDDING = (Stage(0, 0.005, 5.0, False), Stage(1, 0.005, 7.5, False), Stage(1, 0.0025, 8.5, False))
"""The start of CFD3: the coarsest mesh sheds no vortices, the next one does."""
CASES = {
    case.name: case
    for case in (
        Case(
            "CSM3",
            {"ux": (-14.305e-3, 14.305e-3, 1.0995), "uy": (-63.607e-3, 65.160e-3, 1.0995)},
            young=1.4e6,
            gravity=2.0,
            runs=tuple((Stage(*run),) for run in ((0, 0.01, 4.0), (1, 0.01, 4.0), (1, 0.005, 4.0), (2, 0.005, 2.0))),
        ),
        Case(
            "CFD3",
            {"drag": (439.45, 5.6183, 4.3956), "lift": (-11.893, 437.81, 4.3956)},
            velocity=2.0,
            runs=(
                (*SHEDDING, Stage(1, 0.005, 11.0), Stage(1, 0.00125, 11.95)),
                (*SHEDDING, Stage(1, 0.005, 11.0, shown=False), Stage(3, 0.0025, 12.2)),
            ),
        ),
        Case(
            "FSI3",
            {"ux": (-2.88e-3, 2.72e-3, 10.93), "uy": (1.47e-3, 34.99e-3, 5.46)}
            | {"drag": (460.5, 27.74, 10.93), "lift": (2.50, 153.91, 5.46)},
            velocity=2.0,
            young=5.6e6,
            runs=(
                (Stage(0, 0.005, 6.0, False), Stage(1, 0.0025, 8.8), Stage(2, 0.0025, 10.0), Stage(2, 0.00125, 11.2)),
            ),
        ),
    )
}


class Cylinder:
    """The cylinder with its beam in the channel, on one of the meshes, on its way through time."""

    def __init__(self, case: Case, level: int) -> None:
        self.case, self.level = case, level
        self.system = case.system(*MESHES[level], MovingSystem, solid_density=DENSITY)
        if case.young:
            self.system.set_material([case.young], [POISSON])
        self.weights = norm_weights(self.system)
        self._inflow = np.zeros(self.system.space.ndof)
        if case.velocity:
            set_inflow(self.system, case.velocity)
            self._inflow = np.array(self.system.values)
            self.system.values[:] = 0.0

    def prescribe(self, moment: float) -> None:
        """Write the inflow, which grows smoothly to its final value in two seconds."""
        share = 0.5 * (1 - np.cos(np.pi * moment / RAMP)) if moment < RAMP else 1.0
        self.system.values[:] = share * self._inflow

    def moved_from(self, other: "Cylinder", moment: Moment) -> Moment:
        """Return a moment of the same case on another mesh, interpolated to this one."""
        found = []
        for coefficients in (moment.values, moment.rates):
            other.system.values[:] = coefficients
            for mine, theirs in zip(self.system.state.components, other.system.state.components, strict=True):
                mine.Set(theirs)
            found.append(np.array(self.system.values))
        return Moment(moment.time, found[0], found[1])


@dataclass
class Run:
    """The series of a run: times, and one row of `Benchmark.values` each."""

    cylinder: Cylinder
    last: Moment
    jacobians: int = 0
    seconds: float = 0.0
    times: list[float] = field(default_factory=list)
    rows: list[tuple[float, ...]] = field(default_factory=list)

    def advance(self, stage: Stage) -> None:
        began, cylinder = time.perf_counter(), self.cylinder
        settings = StepSettings(stage.step, corrector=NewtonSettings(1e-6, 12, 0.05))
        march = March(cylinder.system, self.last, stage.end, cylinder.prescribe, cylinder.weights, settings)
        for moment in march:
            self.last = moment
            self.times.append(moment.time)
            self.rows.append(cylinder.case.values(cylinder.system))
        self.jacobians += march.jacobians
        self.seconds += time.perf_counter() - began


def simulate(case: Case, stages: Sequence[Stage]) -> Iterator[Run]:
    """Yield the run of each stage; a stage on another mesh goes on from the interpolated state."""
    run: Run | None = None
    for stage in stages:
        if run is None or run.cylinder.level != stage.level:
            cylinder = Cylinder(case, stage.level)
            rest = np.zeros(cylinder.system.space.ndof)
            start = Moment(0.0, rest, rest) if run is None else cylinder.moved_from(run.cylinder, run.last)
        else:
            cylinder, start = run.cylinder, run.last
        run = Run(cylinder, start)
        run.advance(stage)
        yield run


def oscillation(times: np.ndarray, values: np.ndarray, window: float, period: float) -> tuple[float, float, float]:
    """Return mean and amplitude of the extremes in the last period, and the frequency, Hz, in the window at the end.

    Times and steps are in s, steps are even; the window is longer than two periods. Without a period, the frequency is
    NaN, and mean and amplitude are those of the window.
    """
    chosen = times >= times[-1] - window
    t, y = times[chosen], values[chosen]
    y_mean = 0.5 * (y.max() + y.min())
    rising = np.flatnonzero((y[:-1] < y_mean) & (y[1:] >= y_mean))
    if len(rising) < 2:
        return float(y_mean), float(0.5 * (y.max() - y.min())), float("nan")
    crossings = t[rising] + (y_mean - y[rising]) / (y[rising + 1] - y[rising]) * (t[rising + 1] - t[rising])
    frequency = (len(crossings) - 1) / (crossings[-1] - crossings[0])
    last = y[t >= t[-1] - period - 1e-9]
    return float(0.5 * (last.max() + last.min())), float(0.5 * (last.max() - last.min())), float(frequency)


def rows(case: Case, stage: Stage, run: Run) -> list[tuple]:
    """Return a row for each quantity of a stage."""
    found, times, series = [], np.array(run.times), np.array(run.rows)
    period = 1.0 / min(frequency for _, _, frequency in case.reference.values())
    window = min(3.2 * period, run.times[-1] - run.times[0])
    for k, (name, published) in enumerate(case.reference.items()):
        own = oscillation(times, series[:, k], window, period)
        size = (run.cylinder.system.mesh.ne, len(run.cylinder.system.free), stage.step, run.jacobians, run.seconds)
        found.append((name, *published, *size, *own))
    return found


def _of_case(case: Case) -> Table:
    pairs = [pair for stages in case.runs for pair in zip(stages, simulate(case, stages), strict=True)]
    lines = [row for stage, run in pairs if stage.shown for row in rows(case, stage, run)]
    lines.sort(key=lambda row: list(case.reference).index(row[0]))
    heading = (
        "quantity | published mean {.5g} | amplitude {.5g} | Hz {.5g} | elements {d} | unknowns {d} | step, s {g} "
        "| Jacobians {d} | s {.0f} | mean {.5g} | own amplitude {.5g} | own Hz {.4g}"
    )
    return table(case.name, f"{case.name} of Turek and Hron", heading, lines)


if __name__ == "__main__":
    for name in arguments(__doc__, words=CASES).words or CASES:
        show([_of_case(CASES[name])])
