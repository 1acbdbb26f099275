"""A flow cell whose inflow changes with time, with the inertia of fluid and solid."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from strandline.errors import ForwardModelError
from strandline.models.biofilm.cell import FlowCell, Solution
from strandline.models.biofilm.course import Course
from strandline.models.biofilm.flow import DENSITY_SCALE, VELOCITY_SCALE
from strandline.models.biofilm.fluid import Fluid
from strandline.models.biofilm.moving import MovingSystem
from strandline.models.biofilm.newton import NewtonSettings
from strandline.models.biofilm.rates import Moment
from strandline.models.biofilm.system import CoupledSystem
from strandline.models.biofilm.transient import StepSettings, TimeCost, march

__all__ = ["TIME_SCALE", "TransientCell"]

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
CORRECTOR = NewtonSettings(tolerance=1e-8, maximum_jacobians=6, smallest_damping=0.1)


class TransientCell(FlowCell):
    """A `FlowCell` with inertia.

    Args:
        arguments: Arguments of `FlowCell`.
        solid_density: Density of the undeformed solid, kg/m³.
        options: Further arguments of `FlowCell`.
    """

    def __init__(self, *arguments: Any, solid_density: float, **options: Any) -> None:
        self._solid_density = solid_density
        super().__init__(*arguments, **options)

    def coupled(self, *arguments: Any, **options: Any) -> CoupledSystem:
        """Return the system with inertia."""
        return MovingSystem(*arguments, solid_density=self._solid_density / DENSITY_SCALE, **options)

    def through(
        self,
        course: Course,
        young: Sequence[float],
        poisson: Sequence[float],
        rate: float,
        *further: Sequence[float],
        fluid: Fluid | None = None,
        budget: int = 0,
    ) -> Iterator[tuple[str, Solution]]:
        """Yield name and state of each time observed; while one is yielded, the system holds it.

        Args:
            course: Course of the inflow.
            young: Young's modulus of each part, Pa.
            poisson: Poisson's ratio of each part.
            rate: Inflow rate V_in, mm²/s, or the pressure drop, Pa, where the course has the share 1.
            further: Values of each further parameter of the law, one for each part.
            fluid: Fluid without unknown quantities; default: that of the cell, water where unknown.
            budget: Number of Jacobians after which the search for the steady state at the start is given up; 0: none.

        Raises:
            ForwardModelError: As `solve` at the start; ``time_step`` or ``inverted_elements`` later, with the time, s.
        """
        system = self.system
        assert isinstance(system, MovingSystem)
        system.rates.rest()
        start = course.share(course.start) * rate
        steady = self.solve(young, poisson, start, *further, fluid=fluid, budget=budget)
        first = Moment(course.start / TIME_SCALE, np.array(system.values), np.zeros(system.space.ndof))
        observed = {time / TIME_SCALE: name for name, time in course.times}
        if first.time in observed:
            yield observed[first.time], steady
        cost, reached = TimeCost(), first.time

        def prescribe(time: float) -> None:
            share = course.share(time * TIME_SCALE)
            self._apply(self.set_loads(share * rate, fluid or self.fluid))

        settings, stops = _steps(course)
        end = stops[-1] if stops[-1] > first.time else first.time
        options: dict[str, Any] = {"weights": self.weights, "settings": settings, "stops": stops, "cost": cost}
        try:
            for moment in march(system, first, end, prescribe=prescribe, **options):
                reached = moment.time
                bounds = self.check(moment.values[system.free])
                if moment.time in observed:
                    moved = self._interface_values(moment.values)
                    x, figures = moment.values[system.free], (bounds["min_J_fluid"], bounds["min_J_solid"])
                    yield observed[moment.time], Solution(x, moved, *figures, cost.jacobians)
        except ForwardModelError as error:
            spent = {"steps": float(cost.steps), "jacobians": float(cost.jacobians), "time": reached * TIME_SCALE}
            raise ForwardModelError(error.kind, error.message, {**error.evidence, **spent}) from error
        finally:
            system.rates.rest()


def _steps(course: Course) -> tuple[StepSettings, tuple[float, ...]]:
    """Return how to step, and the times that steps meet: those observed, and corners of the course before the last."""
    end = course.times[-1][1]
    met = {time for _, time in course.times} | {time for time, _ in course.inflow if time < end}
    times = np.array(sorted(met | {course.start})) / TIME_SCALE
    stretches = np.diff(times) if len(times) > 1 else np.ones(1)
    settings = StepSettings(
        FIRST_STEP * float(stretches.min()),
        tolerance=course.tolerance,
        largest=float(stretches.max()) / LEAST_STEPS,
        smallest=SMALLEST_STEP,
        floors=FLOORS,
        corrector=CORRECTOR,
    )
    return settings, tuple(times.tolist())
