"""A flow cell whose solid creeps while the inflow changes with time; the flow is steady at every moment.

Each step solves the coupled equations with the stresses that the solid remembers. A step is made once as a whole and
once in halves. A third of the difference is the error of the halves, which are kept (the method is of second order;
Hairer, Nørsett and Wanner, Solving Ordinary Differential Equations I, 1993, section II.4). The errors of all steps add
up to at most the tolerance; earlier errors do not grow, since the solid relaxes.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.foundations import ForwardModelError
from strandline.models.biofilm import newton
from strandline.models.biofilm.cells.cell import FlowCell, Setting, Solution
from strandline.models.biofilm.cells.steady import SHORTER_STEPS, AtLoad, steady_state
from strandline.models.biofilm.equations.flow import Fluid
from strandline.models.biofilm.equations.memory import Branch, Memory, Past
from strandline.models.biofilm.equations.system import CoupledSystem
from strandline.models.biofilm.mesh.course import Course, Piece, pieces
from strandline.models.biofilm.newton import LinearSolver, NewtonSettings, Vector

STEP = NewtonSettings(maximum_jacobians=4, smallest_damping=1.0)
FIRST_STEP = 0.2
"""First step after a sudden change, in shortest relaxation times."""
SHORTEST = 1e-4
"""Shortest step, as a share of the whole time."""
SUDDEN, SMALLEST_SUDDEN = 0.25, 1e-3
"""Largest and smallest change of the inflow at once, as a share of the full one."""
SAFETY, GROWTH, CUT = 0.9, 3.0, 0.2
"""How the next step follows from the error of the last."""


@dataclass(frozen=True, eq=False)
class CreepState:
    """Time, s, share of the full inflow, scaled unknowns, stresses, displacements of the interface (point, 2), mm."""

    time: float
    share: float
    x: Vector
    past: Past
    displacement: Float[np.ndarray, "point 2"]

    @property
    def largest(self) -> float:
        """The largest displacement, mm."""
        return float(np.linalg.norm(self.displacement, axis=1).max())


@dataclass
class QuasiStatic:
    """The way of one specimen through time; the cell has the material set, and its solid remembers.

    `rate` is the full inflow rate, mm²/s, or pressure drop, Pa; `tolerance` the largest error in time of the interface,
    as a share of the largest displacement so far; `budget` that of `steady_state` for a sudden load at rest.
    """

    cell: FlowCell
    rate: float
    fluid: Fluid
    branches: Sequence[Branch]
    tolerance: float
    largest_step: float = np.inf
    budget: int = 0
    steps: int = field(default=0, init=False)
    jacobians: int = field(default=0, init=False)
    _last: LinearSolver | None = field(default=None, init=False)

    def follow(self, course: Course) -> Iterator[CreepState]:
        """Yield the state at each time observed; of a sudden change, that after it.

        A run starts relaxed, in the steady state of the first share. Raises ForwardModelError if no state is found;
        after the start, the evidence holds the `time`, s.
        """
        waiting = [time for _, time in course.times]
        now, step, whole = self._start(course), 0.0, waiting[-1] - course.start
        for piece in pieces(course):
            while waiting and (waiting[0] < piece.begin or (waiting[0] == piece.begin and not piece.is_sudden)):
                del waiting[0]
                yield now
            if piece.is_sudden:
                now, step = self._changed(now, piece.to_share), 0.0
            else:
                now, step = self._through(now, piece, step, whole)
        yield from (now for _ in waiting)

    @property
    def _memory(self) -> Memory:
        assert self.cell.system.memory is not None
        return self.cell.system.memory

    def _start(self, course: Course) -> CreepState:
        """Return the relaxed state of the first share."""
        share, rest = course.inflow[0][1], self._memory.at_rest(len(self.branches))
        self._memory.begin(self._memory.at_rest(0), (), 0.0)
        found = steady_state(self.cell, self._load(share), budget=self.budget)
        self.jacobians += found.jacobians
        self.cell.check(found.x)
        past = self._memory.after(self._memory.at_rest(0), (), 0.0, self.cell.system.elastic_stress)
        return CreepState(course.start, share, found.x, Past(past.elastic, rest.branches), self.cell.displacement)

    def _load(self, share: float) -> float:
        """Set the loads for a share of the inflow; return the load at the end of their path."""
        return self.cell.set_loads(share * self.rate, self.fluid)

    def _changed(self, now: CreepState, share: float) -> CreepState:
        """Return the state after a sudden change of the inflow, reached by changes as small as needed."""
        self._memory.begin(now.past, self.branches, 0.0)
        if not now.x.any():
            found = steady_state(self.cell, self._load(share), budget=self.budget)
            self.jacobians += found.jacobians
            return self._accepted(found.x, now, now.time, share)
        x, reached, change = now.x, now.share, SUDDEN
        while reached != share:
            following = reached + float(np.clip(share - reached, -change, change))
            try:
                x = self._solved(x + self._rigid(following - reached), following)
            except ForwardModelError as error:
                change *= 0.5
                if change < SMALLEST_SUDDEN or error.kind not in SHORTER_STEPS:
                    raise _at(error, now.time) from error
                continue
            reached = following
        return self._accepted(x, now, now.time, share)

    def _through(self, now: CreepState, piece: Piece, step: float, whole: float) -> tuple[CreepState, float]:
        """Return the state at the end of a piece, and the length of the next step."""
        before: CreepState | None = None
        step = step or FIRST_STEP * min((branch.time for branch in self.branches), default=np.inf)
        while now.time < piece.end:
            left, step = piece.end - now.time, min(step, self.largest_step)
            taken = left if step >= 0.999 * left else min(step, 0.5 * left)
            time = piece.end if taken == left else now.time + taken
            try:
                found, error = self._doubled(before, now, piece, time)
            except ForwardModelError as failure:
                step = CUT * taken
                if step < SHORTEST * whole or failure.kind not in SHORTER_STEPS:
                    raise _at(failure, now.time) from failure
                continue
            allowed = self.tolerance * max(now.largest, found.largest) * taken / whole
            wanted = taken * float(np.clip(SAFETY * np.sqrt(allowed / max(error, 1e-300)), CUT, GROWTH))
            if error > allowed and taken > SHORTEST * whole:
                step = wanted
                continue
            step = max(step, wanted) if taken < step else wanted
            before, now, self.steps = now, found, self.steps + 1
        return now, step

    def _doubled(
        self, before: CreepState | None, now: CreepState, piece: Piece, time: float
    ) -> tuple[CreepState, float]:
        """Return the state at `time` after two steps, and the error estimated from a single one, mm."""
        if not self.branches:
            return self._after(before, now, piece, time), 0.0
        half = self._after(before, now, piece, 0.5 * (now.time + time))
        halves = self._after(now, half, piece, time)
        whole = self._after(now, now, piece, time, guess=halves.x)
        difference = np.linalg.norm(whole.displacement - halves.displacement, axis=1).max()
        return halves, float(difference) / 3.0

    def _after(
        self, before: CreepState | None, now: CreepState, piece: Piece, time: float, *, guess: Vector | None = None
    ) -> CreepState:
        """Return the state after one step; the first guess goes on as from `before` to `now`."""
        share, step = piece.share(time), time - now.time
        self._memory.begin(now.past, self.branches, step)
        if guess is None:
            guess = now.x + self._rigid(share - now.share)
            if before is not None:
                guess = now.x + step / (now.time - before.time) * (now.x - before.x)
        return self._accepted(self._solved(guess, share), now, time, share)

    def _solved(self, guess: Vector, share: float) -> Vector:
        """Return the unknowns at a share of the inflow; the last Jacobian serves as long as steps contract well."""
        system = AtLoad(self.cell, self._load(share))
        found = newton.solve_again(system, guess, self._last, weights=self.cell.weights, settings=STEP)
        self.jacobians, self._last = self.jacobians + found.jacobians, found.jacobian
        return found.x

    def _accepted(self, x: Vector, now: CreepState, time: float, share: float) -> CreepState:
        """Return the state of these unknowns after a step from `now`, if it is a valid one."""
        self.cell.check(x)
        past = self._memory.after(now.past, self.branches, time - now.time, self.cell.system.elastic_stress)
        return CreepState(time, share, x, past, self.cell.displacement)

    def _rigid(self, change: float) -> Vector:
        """Return how the flow past a rigid body changes with the share of the inflow."""
        return np.asarray(change * self.rate / self.cell.flow.scale * self.cell.rigid_flow)


def _at(error: ForwardModelError, time: float) -> ForwardModelError:
    kind, message = error.kind, error.message
    if kind != "inverted_elements":
        kind, message = "time_step", "no state that follows from the last was found"
    return ForwardModelError(kind, f"{message}, after {time:.4g} s", {**error.evidence, "time": time})


class CreepingCell(FlowCell):
    """A `FlowCell` whose solid remembers its stresses; the flow is steady at every moment."""

    def coupled(self, *arguments: Any, **options: Any) -> CoupledSystem:
        return CoupledSystem(*arguments, remembers=True, **options)

    def through(self, course: Course, setting: Setting, budget: int = 0) -> Iterator[tuple[str, Solution]]:
        """Yield name and state of each time observed; while one is yielded, the system holds it.

        The rate in the `setting` is where the course has the share 1. The `budget` of Jacobians is for searches along a
        load path; 0: no limit. Raises as `solve` at the start and after a sudden load at rest; later ForwardModelError
        of the kind ``time_step`` or ``inverted_elements``, with the time, s.
        """
        self.set(setting)
        way = QuasiStatic(self, setting.rate, setting.fluid, setting.branches, course.tolerance, budget=budget)
        names = {time: name for name, time in course.times}
        try:
            for moment in way.follow(course):
                self.residual(moment.x, self.set_loads(moment.share * setting.rate, setting.fluid))
                bounds = self.check(moment.x)
                yield names[moment.time], Solution(moment.x, moment.displacement, bounds, way.jacobians)
        except ForwardModelError as error:
            raise self.in_physical_units(error) from error
