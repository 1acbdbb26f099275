"""Steady states of a flow cell that start from anchors.

A run in the box starts from the state that the anchors predict. Broyden's updates of the nearest anchor's factorised
Jacobian usually lead to the steady state; if they do not contract, Newton's method goes on from the prediction; if that
fails too, the run is solved as without anchors. So is each run outside the box, and each whose first-order compression
is predicted above `LARGEST_STRAIN`: there Newton's method alone cannot tell which branch a state is on, see `steady`.
"""

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from strandline.errors import ForwardModelError
from strandline.models.biofilm import newton
from strandline.models.biofilm.anchors.box import Box
from strandline.models.biofilm.anchors.factors import Rescaled, RowsAndColumns
from strandline.models.biofilm.anchors.states import States
from strandline.models.biofilm.cell import FlowCell, Solution
from strandline.models.biofilm.fluid import Fluid
from strandline.models.biofilm.linear import Factorisation
from strandline.models.biofilm.newton import NewtonSettings
from strandline.models.biofilm.steady import DIRECT_STRAIN, SAFE_STRAIN, AtLoad, first_order

__all__ = ["AnchoredCell", "Setting"]

LARGEST_STRAIN = 0.95 * SAFE_STRAIN
MOST_FACTORS = 8
"""Anchors whose Jacobian is kept factorised; spread over the box."""
KEPT = NewtonSettings(1e-8, maximum_jacobians=0, smallest_damping=1.0, contraction=0.7)
"""Steps with a kept Jacobian; the error after the last is shorter than it by the contraction, about a fifth."""
FRESH = NewtonSettings(maximum_jacobians=2, smallest_damping=1.0)

Vector = Float[np.ndarray, " unknown"]


@dataclass(frozen=True)
class Setting:
    """Arguments of `FlowCell.solve`.

    Args:
        young: Young's modulus of each part, Pa.
        poisson: Poisson's ratio of each part.
        rate: Inflow rate, mm²/s, or the pressure drop, Pa.
        further: Values of each further parameter of the law, one for each part.
        fluid: Fluid without unknown quantities.
    """

    young: Sequence[float]
    poisson: Sequence[float]
    rate: float
    further: tuple[Sequence[float], ...]
    fluid: Fluid

    @property
    def stiffness(self) -> float:
        """Shear modulus, the geometric mean over the parts, Pa."""
        moduli = np.array(self.young) / (2.0 * (1.0 + np.array(self.poisson)))
        return float(np.exp(np.log(moduli).mean()))


class AnchoredCell:
    """A flow cell with the anchors of a box.

    Args:
        cell: The flow cell.
        box: Ranges of all inputs.
        setting: The arguments of `FlowCell.solve` by inputs.
        states: The anchors; None: they are solved.
    """

    def __init__(
        self, cell: FlowCell, box: Box, setting: Callable[[Mapping[str, float]], Setting], states: States | None = None
    ) -> None:
        self.cell, self.box, self._setting = cell, box, setting
        self.states = states or States.solve(
            box, self._first_order_strain, lambda at: self._cold(at, 0).unknowns, DIRECT_STRAIN
        )
        self._powers = RowsAndColumns.of(cell.system)
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
        figures = {"anchored": 0.0}
        if self.states.suffice and self.box.holds(inputs):
            at = self.box.coordinates(inputs)
            figures["predicted_strain"] = strain = self.states.strain(at)
            found = self._from_anchors(inputs, at) if strain <= LARGEST_STRAIN else None
            if found is not None:
                return replace(found, figures=figures | {"anchored": 1.0})
        return replace(self._cold(inputs, budget), figures=figures)

    def serves(self, inputs: Mapping[str, float]) -> bool:
        """Return whether a run starts from anchors."""
        if not (self.states.suffice and self.box.holds(inputs)):
            return False
        return self.states.strain(self.box.coordinates(inputs)) <= LARGEST_STRAIN

    def _from_anchors(self, inputs: Mapping[str, float], at: Float[np.ndarray, " axis"]) -> Solution | None:
        """Return the steady state near the prediction; None if Newton's method does not find it."""
        nearest = self._kept[int(np.argmin(self.box.distances(self.states.anchors[self._kept], at)))]
        setting, cell = self._setting(inputs), self.cell
        jacobian = self._factor(nearest)
        anchor = self._setting(self.box.inputs(tuple(self.states.anchors[nearest])))
        load, guess = self._set(setting), self.states.guess(at)
        system, weights = AtLoad(cell, load), cell.weights
        rescaled = Rescaled(jacobian, self._powers, setting.stiffness / anchor.stiffness)
        for settings in (KEPT, FRESH):
            with contextlib.suppress(ForwardModelError):
                first = _first_step(rescaled, system, guess) if settings is KEPT else None
                found = newton.solve(system, guess, weights=weights, settings=settings, first=first)
                return cell.accepted(found.x, load, found.jacobians)
        return None

    def _factor(self, number: int) -> Factorisation:
        """Return the factorised Jacobian of an anchor, made when it is first needed."""
        if number not in self._factors:
            load = self._set(self._setting(self.box.inputs(tuple(self.states.anchors[number]))))
            self._factors[number] = self.cell.factorise(self.states.unknowns[number], load, own_analysis=True)
        return self._factors[number]

    def _set(self, setting: Setting) -> float:
        return self.cell.set(setting.young, setting.poisson, setting.rate, *setting.further, fluid=setting.fluid)

    def _cold(self, inputs: Mapping[str, float], budget: int) -> Solution:
        s = self._setting(inputs)
        return self.cell.solve(s.young, s.poisson, s.rate, *s.further, fluid=s.fluid, budget=budget)

    def _first_order_strain(self, inputs: Mapping[str, float]) -> float:
        load = self._set(self._setting(inputs))
        return self.cell.largest_compression(first_order(self.cell, load).state)


def _first_step(jacobian: newton.LinearSolver, system: AtLoad, x: Vector) -> newton.NewtonStep:
    return newton.NewtonStep(jacobian, -jacobian.solve(system.residual(x)))


def _spread(box: Box, anchors: Float[np.ndarray, "anchor axis"]) -> list[int]:
    """Return the numbers of anchors that lie far from each other, from the middle of all outwards."""
    if not len(anchors):
        return []
    chosen = [int(np.argmin(box.distances(anchors, anchors.mean(0))))]
    while len(chosen) < min(MOST_FACTORS, len(anchors)):
        gaps = np.min([box.distances(anchors, anchors[k]) for k in chosen], axis=0)
        chosen.append(int(np.argmax(gaps)))
    return chosen
