"""A flow cell whose solid creeps while the inflow changes with time."""

from collections.abc import Iterator, Sequence
from typing import Any

from strandline.errors import ForwardModelError
from strandline.models.biofilm.cell import FlowCell, Solution
from strandline.models.biofilm.course import Course
from strandline.models.biofilm.creep.quasi_static import QuasiStatic
from strandline.models.biofilm.fluid import Fluid
from strandline.models.biofilm.memory import Branch
from strandline.models.biofilm.system import CoupledSystem

__all__ = ["CreepingCell"]


class CreepingCell(FlowCell):
    """A `FlowCell` whose solid remembers its stresses; the flow is steady at every moment."""

    def coupled(self, *arguments: Any, **options: Any) -> CoupledSystem:
        """Return the system with a memory."""
        return CoupledSystem(*arguments, remembers=True, **options)

    def through(
        self,
        course: Course,
        branches: Sequence[Branch],
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
            branches: Maxwell branches of the solid.
            young: Young's modulus of each part of the relaxed solid, Pa.
            poisson: Poisson's ratio of each part.
            rate: Inflow rate V_in, mm²/s, or the pressure drop, Pa, where the course has the share 1.
            further: Values of each further parameter of the law, one for each part.
            fluid: Fluid without unknown quantities; default: that of the cell, water where unknown.
            budget: Number of Jacobians after which a search along a load path is given up; 0: none.

        Raises:
            ForwardModelError: As `solve` at the start and after a sudden load at rest; ``time_step`` or
                ``inverted_elements`` later, with the time, s.
        """
        self.set(young, poisson, rate, *further, fluid=fluid)
        way = QuasiStatic(self, rate, fluid or self.fluid, branches, course.tolerance, budget=budget)
        names = {time: name for name, time in course.times}
        try:
            for moment in way.follow(course):
                self.residual(moment.x, self.set_loads(moment.share * rate, fluid or self.fluid))
                fluid_bound, solid_bound = self.distortion()
                figures = (fluid_bound, solid_bound, way.jacobians)
                yield names[moment.time], Solution(moment.x, moment.displacement, *figures)
        except ForwardModelError as error:
            raise self.in_physical_units(error) from error
