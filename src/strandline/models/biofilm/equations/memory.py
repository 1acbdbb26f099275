"""What a solid remembers: the stresses of Maxwell branches that relax, at the points of the quadrature.

The stress is that of an elastic law, Sₑ, and of branches beside it (quasi-linear viscoelasticity; Fung, Biomechanics,
1993, section 7.6; the stress of Simo's generalised Maxwell solid, here of the whole law, not of its shear alone):

    S = Sₑ + Σ Hᵢ,   dHᵢ/dt + Hᵢ/τᵢ = gᵢ dSₑ/dt.

A branch is as stiff as gᵢ times the relaxed law and loses its stress with the time τᵢ. Over a step Δt in which Sₑ is
linear in time, with a = Δt/τᵢ (Taylor, Pister and Goudreau, Int. J. Numer. Methods Eng. 2 (1970) 45),

    Hᵢ ← e⁻ᵃ Hᵢ + gᵢ (1 - e⁻ᵃ)/a ΔSₑ,

which is exact then, of second order otherwise, stable for every step, and holds for a sudden change, Δt = 0, too.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import ngsolve as ng
import numpy as np
from jaxtyping import Float
from ngsolve.comp import IntegrationRuleSpace

from strandline.models.protocol import ModelInput

MOST_BRANCHES = 3
ORDER = 2
"""Order of the quadrature over the solid."""

Stresses = Float[np.ndarray, " entry"]


@dataclass(frozen=True)
class Branch:
    """A Maxwell branch: its stiffness over that of the relaxed solid, and its relaxation time, s, both above 0."""

    ratio: float
    time: float

    def over(self, step: float) -> tuple[float, float]:
        """Return by which factor a stress relaxes in a step, s, and which share of a change of Sₑ it takes."""
        a = step / self.time
        return float(np.exp(-a)), self.ratio * (1.0 if a == 0.0 else float(-np.expm1(-a) / a))


@dataclass(frozen=True, eq=False)
class Past:
    """The stresses at a point in time: Sₑ and Hᵢ at all points of the quadrature."""

    elastic: Stresses
    branches: tuple[Stresses, ...]


def branch_inputs(number: int) -> tuple[tuple[ModelInput, ModelInput], ...]:
    """Return the inputs ratio and tau of each branch, which end with its number if there are several."""
    ends = [""] if number == 1 else [str(k) for k in range(1, number + 1)]
    return tuple((_of_branch("ratio", "1", end), _of_branch("tau", "s", end)) for end in ends)


def _of_branch(name: str, unit: str, end: str) -> ModelInput:
    branch = f"branch {end}" if end else "the branch"
    meaning = f"relaxation time of {branch}" if unit == "s" else f"modulus of {branch} over that of the relaxed solid"
    return ModelInput(name + end, unit, 0.0, np.inf, low_included=False, high_included=False, meaning=meaning)


class Memory:
    """Adds the branches to the stress of a law; belongs to one mesh."""

    def __init__(self, mesh: Any) -> None:
        points = IntegrationRuleSpace(mesh, order=ORDER)
        self._rules = points.GetIntegrationRules()
        space = ng.MatrixValued(points, 2, symmetric=True)
        self._elastic, self._carried = ng.GridFunction(space), ng.GridFunction(space)
        self._factor = ng.Parameter(1.0)

    def stress(self, elastic: Any) -> Any:
        """Return the form of the whole stress, from that of the law."""
        return self._factor * elastic + self._carried

    def dx(self, region: str) -> Any:
        """Return the element of volume for which the stresses are known."""
        return ng.dx(region, intrules=self._rules)

    def at_rest(self, branches: int) -> Past:
        """Return the stresses of a solid that was never loaded."""
        none = np.zeros(len(self._elastic.vec))
        return Past(none, (none,) * branches)

    def begin(self, past: Past, branches: Sequence[Branch], step: float) -> None:
        """Let the stress be that at the end of a step, s, after `past`; a step of 0 is a sudden change."""
        factor, carried = 1.0, np.zeros_like(past.elastic)
        for branch, stress in zip(branches, past.branches, strict=True):
            kept, taken = branch.over(step)
            factor += taken
            carried += kept * stress - taken * past.elastic
        self._factor.Set(factor)
        self._carried.vec.FV().NumPy()[:] = carried

    def after(self, past: Past, branches: Sequence[Branch], step: float, elastic: Any) -> Past:
        """Return the stresses at the end of a step, s, after `past`; `elastic` is Sₑ there, an NGSolve function."""
        self._elastic.Interpolate(elastic)
        now = np.array(self._elastic.vec.FV().NumPy())
        changed = []
        for branch, stress in zip(branches, past.branches, strict=True):
            kept, taken = branch.over(step)
            changed.append(kept * stress + taken * (now - past.elastic))
        return Past(now, tuple(changed))
