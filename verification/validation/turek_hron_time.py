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
from verification.validation.turek_hron import BOUNDARIES, COARSEST, RIGID, force, norm_weights, set_inflow
from verification.validation.turek_mesh import TIP, Size, mesh_turek_hron

from strandline.models.biofilm.moving import Moment, MovingSystem
from strandline.models.biofilm.newton import NewtonSettings
from strandline.models.biofilm.transient import StepSettings, TimeCost, march

POISSON, RAMP = 0.4, 2.0
WAKE = Size(far=0.035, near=0.007, corner=0.004)
MESHES = ((COARSEST, 0), (COARSEST, 1), (COARSEST, 2), (WAKE, 0))
"""Element sizes, and how often all elements are quartered; the last mesh is finer in the wake."""
Published = tuple[float, float, float]


@dataclass(frozen=True)
class Stage:
    """A stretch of a run on one mesh with one step.

    Args:
        level: Place of the mesh in `MESHES`.
        step: Step, s.
        end: Time of its end, s.
        shown: Whether the table shows its last period.
    """

    level: int
    step: float
    end: float
    shown: bool = True


@dataclass(frozen=True)
class Case:
    """One of the three benchmarks.

    Args:
        name: Published name.
        reference: Published mean, amplitude and frequency (Hz) of displacement (m) and force (N/m).
        runs: Runs of the table, each a list of stages that go on from one another.
        velocity: Mean inflow velocity, m/s; 0: no fluid.
        young: Young's modulus of the beam, Pa; None for a rigid beam.
        gravity: Gravity, m/s², downwards.
        density: Density of the beam, kg/m³.
    """

    name: str
    reference: dict[str, Published]
    runs: tuple[tuple[Stage, ...], ...]
    velocity: float = 0.0
    young: float | None = None
    gravity: float = 0.0
    density: float = 1e3


SHEDDING = (Stage(0, 0.005, 5.0, False), Stage(1, 0.005, 7.5, False), Stage(1, 0.0025, 8.5, False))
"""The start of CFD3: the coarsest mesh sheds no vortices, the next one does."""
CASES = {
    case.name: case
    for case in (
        Case(
            "CSM3",
            {"ux": (-14.305e-3, 14.305e-3, 1.0995), "uy": (-63.607e-3, 65.160e-3, 1.0995)},
            tuple((Stage(*run),) for run in ((0, 0.01, 4.0), (1, 0.01, 4.0), (1, 0.005, 4.0), (2, 0.005, 2.0))),
            young=1.4e6,
            gravity=2.0,
        ),
        Case(
            "CFD3",
            {"drag": (439.45, 5.6183, 4.3956), "lift": (-11.893, 437.81, 4.3956)},
            (
                (*SHEDDING, Stage(1, 0.005, 11.0), Stage(1, 0.00125, 11.95)),
                (*SHEDDING, Stage(1, 0.005, 11.0, shown=False), Stage(3, 0.0025, 12.2)),
            ),
            velocity=2.0,
        ),
        Case(
            "FSI3",
            {
                "ux": (-2.88e-3, 2.72e-3, 10.93),
                "uy": (1.47e-3, 34.99e-3, 5.46),
                "drag": (460.5, 27.74, 10.93),
                "lift": (2.50, 153.91, 5.46),
            },
            (
                (
                    Stage(0, 0.005, 6.0, shown=False),
                    Stage(1, 0.0025, 8.8),
                    Stage(2, 0.0025, 10.0),
                    Stage(2, 0.00125, 11.2),
                ),
            ),
            velocity=2.0,
            young=5.6e6,
        ),
    )
}


class Cylinder:
    """The cylinder with its beam in the channel, on one of the meshes, on its way through time."""

    def __init__(self, case: Case, level: int) -> None:
        self.case, self.level = case, level
        fluid, solid = case.velocity > 0, case.young is not None
        self.mesh = mesh_turek_hron(*MESHES[level], order=2, fluid=fluid, solid=solid)
        self.system = MovingSystem(
            self.mesh,
            BOUNDARIES if solid else RIGID,
            solid_density=case.density,
            viscosity=1.0,
            density=1e3,
            solids=("solid",) if solid else (),
            body_force=(0.0, -case.density * case.gravity),
        )
        if case.young is not None:
            self.system.set_material([case.young], [POISSON])
        self.weights = norm_weights(self.system)
        self._inflow = np.zeros(self.system.space.ndof)
        if fluid:
            set_inflow(self.system, case.velocity)
            self._inflow = np.array(self.system.values)
            self.system.values[:] = 0.0

    def at_rest(self) -> Moment:
        """Return the state at time 0."""
        return Moment(0.0, np.zeros(self.system.space.ndof), np.zeros(self.system.space.ndof))

    def prescribe(self, moment: float) -> None:
        """Write the inflow, which grows smoothly to its final value in two seconds."""
        share = 0.5 * (1 - np.cos(np.pi * moment / RAMP)) if moment < RAMP else 1.0
        self.system.values[:] = share * self._inflow

    def quantities(self) -> tuple[float, ...]:
        """Return displacement of the beam's tip and force on cylinder and beam, as far as there are any."""
        found: tuple[float, ...] = ()
        if self.case.young:
            found += tuple(self.system.state.components[2](self.mesh(*TIP)))
        if self.case.velocity:
            found += force(self.system)
        return found

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
    """The series of a run: times, and one row of `Cylinder.quantities` each."""

    cylinder: Cylinder
    last: Moment
    cost: TimeCost = field(default_factory=TimeCost)
    seconds: float = 0.0
    times: list[float] = field(default_factory=list)
    rows: list[tuple[float, ...]] = field(default_factory=list)

    def advance(self, stage: Stage) -> None:
        """Step through a stage."""
        began, cylinder = time.perf_counter(), self.cylinder
        options = {"prescribe": cylinder.prescribe, "weights": cylinder.weights, "cost": self.cost}
        settings = StepSettings(stage.step, corrector=NewtonSettings(1e-6, 12, 0.05))
        for moment in march(cylinder.system, self.last, stage.end, settings=settings, **options):
            self.last = moment
            self.times.append(moment.time)
            self.rows.append(cylinder.quantities())
        self.seconds += time.perf_counter() - began


def simulate(case: Case, stages: Sequence[Stage]) -> Iterator[Run]:
    """Yield the run of each stage; a stage on another mesh goes on from the interpolated state."""
    run: Run | None = None
    for stage in stages:
        if run is None or run.cylinder.level != stage.level:
            cylinder = Cylinder(case, stage.level)
            start = cylinder.at_rest() if run is None else cylinder.moved_from(run.cylinder, run.last)
        else:
            cylinder, start = run.cylinder, run.last
        run = Run(cylinder, start)
        run.advance(stage)
        yield run


@dataclass(frozen=True)
class Oscillation:
    """Mean and amplitude of the extremes in the last period, and the frequency, Hz; NaN if there is no period."""

    mean: float
    amplitude: float
    frequency: float


def oscillation(
    times: Sequence[float], values: Sequence[float], *, window: float, period: float | None = None
) -> Oscillation:
    """Return the oscillation in the last part of a series of even steps.

    Args:
        times: Times, s.
        values: Values at the times.
        window: Length of the last part, s, more than two periods.
        period: Length of time over which extremes are taken, s; default: the period of the values.
    """
    t, y = np.array(times), np.array(values)
    chosen = t >= t[-1] - window
    t, y = t[chosen], y[chosen]
    y_mean = 0.5 * (y.max() + y.min())
    rising = np.flatnonzero((y[:-1] < y_mean) & (y[1:] >= y_mean))
    if len(rising) < 2:
        return Oscillation(float(y_mean), float(0.5 * (y.max() - y.min())), float("nan"))
    crossings = t[rising] + (y_mean - y[rising]) / (y[rising + 1] - y[rising]) * (t[rising + 1] - t[rising])
    frequency = (len(crossings) - 1) / (crossings[-1] - crossings[0])
    last = y[t >= t[-1] - (period or 1.0 / frequency) - 1e-9]
    return Oscillation(float(0.5 * (last.max() + last.min())), float(0.5 * (last.max() - last.min())), float(frequency))


def rows(case: Case, stage: Stage, run: Run) -> list[tuple]:
    """Return a row of the table for each quantity."""
    found = []
    period = 1.0 / min(frequency for _, _, frequency in case.reference.values())
    for k, (name, published) in enumerate(case.reference.items()):
        window = min(3.2 * period, run.times[-1] - run.times[0])
        own = oscillation(run.times, [row[k] for row in run.rows], window=window, period=period)
        size = (run.cylinder.mesh.ne, len(run.cylinder.system.free), stage.step, run.cost.jacobians, run.seconds)
        found.append((name, *published, *size, own.mean, own.amplitude, own.frequency))
    return found


def of_case(case: Case) -> Table:
    """Return the table of a case: published and own values."""
    lines = [
        row
        for stages in case.runs
        for stage, run in zip(stages, simulate(case, stages), strict=True)
        if stage.shown
        for row in rows(case, stage, run)
    ]
    lines.sort(key=lambda row: list(case.reference).index(row[0]))
    heading = (
        "quantity | published mean {.5g} | amplitude {.5g} | Hz {.5g} | elements {d} | unknowns {d} | step, s {g} "
        "| Jacobians {d} | s {.0f} | mean {.5g} | own amplitude {.5g} | own Hz {.4g}"
    )
    return table(case.name, f"{case.name} of Turek and Hron", heading, lines)


if __name__ == "__main__":
    for name in arguments(__doc__, words=CASES).words or CASES:
        show([of_case(CASES[name])])
