"""Steady states of a flow cell that start from anchors.

A run in the box starts from the state that the anchors predict. Broyden's updates of the nearest anchor's factorised
Jacobian usually lead to the steady state; if they do not contract, Newton's method goes on from the prediction; if that
fails too, the run is solved as without anchors. So is each run outside the box, and each whose first-order compression
is predicted above `LARGEST_STRAIN`: there Newton's method alone cannot tell which branch a state is on, see `steady`.

The Jacobian of an anchor is rescaled to the stiffness of a run. Let the run's solid be s times as stiff as the
anchor's. Multiply by s the Jacobian's rows of momentum in fluid and solid, and divide by s its columns of v, p and pₛ.
In the solid and its constraint the result is the run's Jacobian: the stress there is proportional to Young's modulus.
In the fluid the derivatives by v and p are unchanged, and only those by the moving geometry, which are weaker, are s
times too large. So an anchor serves runs of very different stiffness.
"""

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from strandline.errors import ForwardModelError
from strandline.models.biofilm import newton
from strandline.models.biofilm.anchors import Box, States
from strandline.models.biofilm.cell import FlowCell, Setting, Solution
from strandline.models.biofilm.linear import Factorisation
from strandline.models.biofilm.newton import NewtonSettings
from strandline.models.biofilm.steady import DIRECT_STRAIN, SAFE_STRAIN, AtLoad, first_order
from strandline.models.biofilm.system import CoupledSystem

Vector = Float[np.ndarray, " unknown"]
LARGEST_STRAIN = 0.95 * SAFE_STRAIN
MOST_FACTORS = 8
"""Anchors whose Jacobian is kept factorised; spread over the box."""
KEPT = NewtonSettings(1e-8, maximum_jacobians=0, smallest_damping=1.0, contraction=0.7)
"""Steps with a kept Jacobian; the error after the last is shorter than it by the contraction, about a fifth."""
FRESH = NewtonSettings(maximum_jacobians=2, smallest_damping=1.0)


class Rescaled:
    """The factorised Jacobian of an anchor, for runs whose solid is `ratio` times as stiff."""

    def __init__(self, factorised: Factorisation, system: CoupledSystem, ratio: float) -> None:
        self._factorised = factorised
        displacement, is_motion = system.block(2), system.is_motion[system.free]
        constraint = ~(system.block(0) | system.block(1) | displacement)
        self._rows, self._columns = ratio ** -(1.0 - (is_motion | constraint)), ratio ** -(displacement - 1.0)

    def solve(self, right: Vector) -> Vector:
        return np.asarray(self._columns * self._factorised.solve(self._rows * right))


class AnchoredCell:
    """A flow cell with the anchors of a box of its inputs; `setting` gives what a run is made with, by its inputs."""

    def __init__(
        self, cell: FlowCell, box: Box, setting: Callable[[Mapping[str, float]], Setting], states: States | None = None
    ) -> None:
        self.cell, self.box, self._setting = cell, box, setting
        self.states = states or self._solved()
        self._factors: dict[int, Factorisation] = {}
        self._kept = _spread(box, self.states.anchors)

    def solve(self, inputs: Mapping[str, float], budget: int) -> Solution:
        """Return the steady state; it depends on the inputs alone.

        Args:
            inputs: Inputs by name, among them what drives the flow.
            budget: Number of Jacobians after which a search without anchors is given up; 0: no limit.

        Raises:
            ForwardModelError: As `FlowCell.solve`, which is then called.
        """
        figures, strain = {"anchored": 0.0}, self._predicted_strain(inputs)
        if np.isfinite(strain):
            figures["predicted_strain"] = strain
        found = self._from_anchors(inputs) if strain <= LARGEST_STRAIN else None
        if found is not None:
            return replace(found, figures=figures | {"anchored": 1.0})
        return replace(self.cell.solve(self._setting(inputs), budget), figures=figures)

    def serves(self, inputs: Mapping[str, float]) -> bool:
        """Return whether a run starts from anchors."""
        return self._predicted_strain(inputs) <= LARGEST_STRAIN

    def _solved(self) -> States:
        """Return the states at the points of the box; where it bends too far, or the run fails, there is no anchor."""
        points, strains, solved, unknowns = [], [], [], []
        for point in self.box.points():
            with contextlib.suppress(ForwardModelError):
                inputs = self.box.inputs(point)
                strain = self._first_order_strain(inputs)
                points.append(point)
                strains.append(max(strain, np.finfo(float).tiny))
                solved.append(False)
                if strain <= DIRECT_STRAIN:
                    unknowns.append(self.cell.solve(self._setting(inputs)).unknowns)
                    solved[-1] = True
        return States(
            np.array(points).reshape(len(points), len(self.box.axes)),
            np.array(strains),
            np.array(solved, dtype=bool),
            np.array(unknowns) if unknowns else np.empty((0, 0)),
        )

    def _first_order_strain(self, inputs: Mapping[str, float]) -> float:
        load = self.cell.set(self._setting(inputs))
        start, first = first_order(self.cell, load)
        return self.cell.largest_compression(np.asarray(start + first.correction))

    def _predicted_strain(self, inputs: Mapping[str, float]) -> float:
        """Return the first-order compression that the anchors predict; infinity if they do not serve these inputs."""
        if not (self.states.suffice and self.box.holds(inputs)):
            return np.inf
        return self.states.strain(self.box.coordinates(inputs))

    def _from_anchors(self, inputs: Mapping[str, float]) -> Solution | None:
        """Return the steady state near the prediction; None if Newton's method does not find it."""
        at = self.box.coordinates(inputs)
        nearest = self._kept[int(np.argmin(self.box.distances(self.states.anchors[self._kept], at)))]
        setting, cell = self._setting(inputs), self.cell
        jacobian = self._factor(nearest)
        anchor = self._setting(self.box.inputs(tuple(self.states.anchors[nearest])))
        load, guess = cell.set(setting), self.states.guess(at)
        system, weights = AtLoad(cell, load), cell.weights
        rescaled = Rescaled(jacobian, cell.system, setting.stiffness / anchor.stiffness)
        for settings in (KEPT, FRESH):
            with contextlib.suppress(ForwardModelError):
                first = newton.step(system, guess, rescaled) if settings is KEPT else None
                found = newton.solve(system, guess, weights=weights, settings=settings, first=first)
                return cell.accepted(found.x, load, found.jacobians)
        return None

    def _factor(self, number: int) -> Factorisation:
        """Return the factorised Jacobian of an anchor, made when it is first needed."""
        if number not in self._factors:
            load = self.cell.set(self._setting(self.box.inputs(tuple(self.states.anchors[number]))))
            self._factors[number] = self.cell.factorise(self.states.unknowns[number], load, own_analysis=True)
        return self._factors[number]


def _spread(box: Box, anchors: Float[np.ndarray, "anchor axis"]) -> list[int]:
    """Return the numbers of anchors that lie far from each other, from the middle of all outwards."""
    if not len(anchors):
        return []
    chosen = [int(np.argmin(box.distances(anchors, anchors.mean(0))))]
    while len(chosen) < min(MOST_FACTORS, len(anchors)):
        gaps = np.min([box.distances(anchors, anchors[k]) for k in chosen], axis=0)
        chosen.append(int(np.argmax(gaps)))
    return chosen
