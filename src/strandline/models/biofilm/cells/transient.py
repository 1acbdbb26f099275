"""Runs through time with inertia: implicit steps of second order, fixed or chosen by the error that each one makes.

The scheme is BDF2 with steps of any length, started by one step of backward Euler. Fluid, solid, mesh and pressures are
solved together at the new time. BDF2 is chosen over Crank–Nicolson and generalised-α because it damps what a step does
not resolve (L-stable), imposes the constraints (no flow through the interface, mass, pressure) at the new time, so that
pressures and forces are of second order too, and needs no starting values for them. Its price: an oscillation of
circular frequency ω is slower by (ωh)²/3 and loses (ωh)⁴/4 of its amplitude per step h.

Sources: Hairer and Wanner, Solving Ordinary Differential Equations II (1996), chapters V.1 and VII.3 (multistep methods
for constraints of index 2); Hairer, Nørsett and Wanner, Solving Ordinary Differential Equations I (1993), section II.4,
for the choice of steps.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.foundations import ForwardModelError
from strandline.models.biofilm import newton
from strandline.models.biofilm.cells.cell import FlowCell, Setting, Solution
from strandline.models.biofilm.equations.flow import DENSITY_SCALE, VELOCITY_SCALE
from strandline.models.biofilm.equations.moving import LARGEST_RATIO, Moment, MovingSystem, extrapolated, share_of_error
from strandline.models.biofilm.equations.system import CoupledSystem, Values
from strandline.models.biofilm.mesh.course import Course
from strandline.models.biofilm.newton import LinearSolver, NewtonSettings, Vector

AS_BEFORE = 0.25
"""A Jacobian is kept while its leading weight differs from that of the step by at most this share."""
SLOW = 8
"""Number of corrections in a step after which the next step begins with a new Jacobian."""
SHARE_OF_TOLERANCE = 0.9
SMALLEST_FACTOR, KEPT_FACTOR = 0.25, 1.2
CORRECTOR = NewtonSettings(tolerance=1e-8, maximum_jacobians=6, smallest_damping=0.1)
TIME_SCALE = 1.0 / VELOCITY_SCALE
"""1 mm over the velocity scale, s."""
FIRST_STEP = 1e-3
"""First step as a share of the shortest stretch between times observed and corners of the course."""
SMALLEST_STEP = 0.01
"""Smallest step as a share of the first."""
LEAST_STEPS = 4
"""Smallest number of steps in the longest stretch."""
FLOORS = (1e-3, 1e-3)
"""Velocity, scaled, and displacement, mm, below which the tolerance is a share of these."""


@dataclass(frozen=True)
class StepSettings:
    """How a run steps through time.

    The tolerance is the largest local error of a step in velocity and in displacement, each as a share of the largest
    value in the run so far, which is at least the floor; None: all steps are like the first. Steps are scaled; the
    smallest, below which a run fails, is a share of the first.
    """

    first: float
    tolerance: float | None = None
    largest: float = np.inf
    smallest: float = 1e-6
    floors: tuple[float, float] = (1e-6, 1e-6)
    corrector: NewtonSettings = CORRECTOR


@dataclass(eq=False)
class March:
    """A run through time: yields the moment after each step; while one is yielded, the system holds its state.

    It counts its steps, those repeated with a shorter one (`rejected`), and the Jacobians factorised. Iterating raises
    ForwardModelError: ``time_step``: the steps became too short; or what the system raises.

    The start has the velocity of the solid in its rates. `prescribe` writes values and loads at a time into the system.
    Steps meet the `stops`, where loads have kinks or results are due, and the `end`; all times are scaled.
    """

    system: MovingSystem
    start: Moment
    end: float
    prescribe: Callable[[float], None]
    weights: Vector
    settings: StepSettings
    stops: tuple[float, ...] = ()
    steps: int = field(default=0, init=False)
    rejected: int = field(default=0, init=False)
    jacobians: int = field(default=0, init=False)
    _jacobian: LinearSolver | None = field(default=None, init=False)
    _leading: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        self.last = [self.start]  # the last three moments, newest first
        self._step = self.settings.first
        self._largest = np.maximum(self._sizes(self.start.values), self.settings.floors)

    def __iter__(self) -> Iterator[Moment]:
        for target in sorted({*(time for time in self.stops if self.start.time < time < self.end), self.end}):
            while self.last[0].time < target:
                yield self._advance(target)

    def _advance(self, target: float) -> Moment:
        """Take one step towards the target, shorter until its error is small enough; return the new moment."""
        while True:
            time = self._next_time(target)
            taken = time - self.last[0].time
            try:
                moment, error = self._solved(time)
            except ForwardModelError as reason:
                self._shorten(0.5 * taken, reason)
                continue
            if self.settings.tolerance is not None:
                size = max(error / self.settings.tolerance, 1e-8)
                factor = max(SMALLEST_FACTOR, SHARE_OF_TOLERANCE * size ** (-1 / (2 if len(self.last) == 1 else 3)))
                if size > 1.0:
                    self._shorten(min(factor, SHARE_OF_TOLERANCE) * taken, None)
                    continue
                if factor < 1.0 or factor > KEPT_FACTOR:
                    self._step = max(self._step, taken) if factor > 1.0 else taken
                    self._step = min(factor * taken, LARGEST_RATIO * taken, self.settings.largest)
            self._accept(moment)
            return moment

    def _next_time(self, target: float) -> float:
        """Return the end of the next step: the target itself if that is near, and no sliver left before it."""
        now = self.last[0].time
        step = self._step
        if len(self.last) > 1 and self.settings.tolerance is not None:
            step = min(step, LARGEST_RATIO * (now - self.last[1].time))
        number = int(np.ceil((target - now) / step - 1e-6))
        if number <= 1:
            return target
        equal = self.settings.tolerance is None or number == 2
        return now + ((target - now) / number if equal else step)

    def _solved(self, time: float) -> tuple[Moment, float]:
        """Return the moment at `time`, and the local error as a share of the largest velocity and displacement."""
        system = self.system
        system.rates.set(time, self.last)
        predicted = extrapolated(time, self.last)
        self.prescribe(time)
        x = self._corrected(predicted[system.free])
        system.set_unknowns(x)
        values = np.array(system.values)
        sizes = np.maximum(self._largest, self._sizes(values))
        off = share_of_error(time, self.last) * self._sizes(values - predicted)
        return Moment(time, values, system.rates.first(values)), float((off / sizes).max())

    def _corrected(self, guess: Vector) -> Vector:
        """Return the solution of the step's equations; the last Jacobian is used as long as it serves."""
        leading, settings = self.system.rates.leading, self.settings.corrector
        kept = self._jacobian if abs(leading - self._leading) <= AS_BEFORE * self._leading else None
        found = newton.solve_again(self.system, guess, kept, weights=self.weights, settings=settings)
        self.jacobians += found.jacobians
        if found.jacobians:
            self._leading = leading
        self._jacobian = found.jacobian if found.jacobians or found.simplified_steps <= SLOW else None
        return found.x

    def _accept(self, moment: Moment) -> None:
        self.last = [moment, *self.last[:2]]
        self._largest = np.maximum(self._largest, self._sizes(moment.values))
        self.steps += 1

    def _shorten(self, step: float, reason: ForwardModelError | None) -> None:
        self.rejected += 1
        self._jacobian = None
        if self.settings.tolerance is None and reason is not None:
            raise reason
        if step < self.settings.smallest * self.settings.first:
            now = {"time": self.last[0].time, "step": step}
            message = f"the steps became too short at the scaled time {now['time']:.6g}"
            if reason is not None:
                message += f" ({reason})"
            raise ForwardModelError("time_step", message, now) from reason
        self._step = step

    def _sizes(self, values: Values) -> Float[np.ndarray, " 2"]:
        """Return the largest coefficients of velocity and displacement."""
        parts = [values[part.start : part.stop] for part in (self.system.space.Range(k) for k in (0, 2))]
        return np.array([np.abs(part).max(initial=0.0) for part in parts])


class TransientCell(FlowCell):
    """A `FlowCell` with inertia, made from its arguments and the density of the undeformed solid, kg/m³."""

    def __init__(self, *arguments: Any, solid_density: float, **options: Any) -> None:
        self._solid_density = solid_density
        super().__init__(*arguments, **options)

    def coupled(self, *arguments: Any, **options: Any) -> CoupledSystem:
        return MovingSystem(*arguments, solid_density=self._solid_density / DENSITY_SCALE, **options)

    def through(self, course: Course, setting: Setting, budget: int = 0) -> Iterator[tuple[str, Solution]]:
        """Yield name and state of each time observed; while one is yielded, the system holds it.

        The rate in the `setting` is where the course has the share 1. The `budget` of Jacobians is for the search for
        the steady state at the start; 0: no limit. Raises as `solve` at the start; later ForwardModelError of the kind
        ``time_step`` or ``inverted_elements``, with the time, s.
        """
        system = self.system
        assert isinstance(system, MovingSystem)
        system.rates.rest()
        steady = self.solve(replace(setting, rate=course.share(course.start) * setting.rate), budget)
        first = Moment(course.start / TIME_SCALE, np.array(system.values), np.zeros(system.space.ndof))
        observed = {time / TIME_SCALE: name for name, time in course.times}
        if first.time in observed:
            yield observed[first.time], steady
        reached = first.time

        def prescribe(time: float) -> None:
            share = course.share(time * TIME_SCALE)
            self._apply(self.set_loads(share * setting.rate, setting.fluid))

        settings, stops = _steps(course)
        march = March(system, first, max(stops[-1], first.time), prescribe, self.weights, settings, stops)
        try:
            for moment in march:
                reached = moment.time
                bounds = self.check(moment.values[system.free])
                if moment.time in observed:
                    x, moved = moment.values[system.free], self._interface_values(moment.values)
                    yield observed[moment.time], Solution(x, moved, bounds, march.jacobians)
        except ForwardModelError as error:
            spent = {"steps": float(march.steps), "jacobians": float(march.jacobians), "time": reached * TIME_SCALE}
            raise ForwardModelError(error.kind, error.message, {**error.evidence, **spent}) from error
        finally:
            system.rates.rest()


def _steps(course: Course) -> tuple[StepSettings, tuple[float, ...]]:
    """Return how to step, and the times that steps meet: those observed, and corners of the course before the last."""
    end = course.times[-1][1]
    met = {time for _, time in course.times} | {time for time, _ in course.inflow if time < end}
    times = np.array(sorted(met | {course.start})) / TIME_SCALE
    stretches = np.diff(times) if len(times) > 1 else np.ones(1)
    first, largest = FIRST_STEP * float(stretches.min()), float(stretches.max()) / LEAST_STEPS
    settings = StepSettings(first, course.tolerance, largest, smallest=SMALLEST_STEP, floors=FLOORS)
    return settings, tuple(times.tolist())
