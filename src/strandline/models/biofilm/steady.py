"""The steady state at a load: by Newton's method at once, or along the load path if the solid bends far.

The largest compressive strain of the first-order solution decides which. Below `SAFE_STRAIN` full Newton steps reach
the steady state. Above `DIRECT_STRAIN` the fold of the Saint-Venant–Kirchhoff law has been passed in every run seen,
and only the path shows it. Between them Newton's method is tried first, and what it finds has to lie on the branch that
is connected with the state at rest: there the most compressed element is compressed further as the load grows.
`docs/results/forward-model.md` shows the figures behind these bounds.
"""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from strandline.errors import ForwardModelError
from strandline.models.biofilm import newton
from strandline.models.biofilm.continuation import LoadedSystem, Steady, trace
from strandline.models.biofilm.newton import LinearSolver, NewtonSettings, NewtonStep
from strandline.models.biofilm.strain import Strain

SAFE_STRAIN = 0.2
DIRECT_STRAIN = 0.27
FIRST_STRAIN = 0.25
"""First-order compression at the first point of the path; see `FIRST_SHARE`."""
FIRST_SHARE = 0.8
"""The first point of the path lies at most at this share of the load."""
SHORTEST_PATH = 2
"""Smallest number of Jacobians for a path."""
DIRECT = NewtonSettings(maximum_jacobians=4, smallest_damping=1.0)

Vector = Float[np.ndarray, " unknown"]


@runtime_checkable
class Bending(LoadedSystem, Protocol):
    """A loaded solid in a flow."""

    def undeformed(self, load: float) -> Vector: ...

    def largest_compression(self, x: Vector) -> float: ...

    def largest_strain(self, x: Vector) -> Strain: ...


def first_order(bending: Bending, load: float) -> tuple[Vector, NewtonStep]:
    """Return the flow past a rigid body, and Newton's step from there; raises what `bending` raises."""
    start = bending.undeformed(load)
    return start, newton.step(AtLoad(bending, load), start)


def steady_state(bending: Bending, load: float, *, budget: int = 0) -> Steady:
    """Return the steady state at a load that is connected with the one at rest.

    The `budget` is a number of Jacobians after which a search along the load path is given up; 0: no limit.

    Raises:
        ForwardModelError: For the reasons given in `continuation.trace`.
    """
    start, first = first_order(bending, load)
    linear = np.asarray(start + first.correction)
    strain = bending.largest_compression(linear)
    spent = 1
    if strain <= DIRECT_STRAIN:
        try:
            system, weights = AtLoad(bending, load), bending.weights
            found = newton.solve(system, start, weights=weights, settings=DIRECT, first=first)
            spent += found.jacobians
            if strain <= SAFE_STRAIN:
                return Steady(found.x, spent)
            spent += 1
            if _on_first_branch(bending, found.x, load):
                return Steady(found.x, spent)
        except ForwardModelError as error:
            spent += int(error.evidence.get("jacobians", 0))
    first_load = load * min(FIRST_SHARE, FIRST_STRAIN / strain)
    left = max(SHORTEST_PATH, budget - spent) if budget else 0
    try:
        traced = trace(bending, linear=linear, load=load, first_load=first_load, budget=left)
    except ForwardModelError as error:
        total = {"jacobians": error.evidence.get("jacobians", 0.0) + spent}
        raise ForwardModelError(error.kind, error.message, error.evidence | total) from error
    return Steady(traced.x, spent + traced.jacobians)


def _on_first_branch(bending: Bending, x: Vector, load: float) -> bool:
    """Return whether the most compressed element is compressed further as the load grows."""
    jacobian = bending.factorise(x, load)
    tangent = -jacobian.solve(bending.by_load())
    return bool(bending.largest_strain(x).functional @ tangent > 0.0)


class AtLoad:
    """The equations of a loaded solid at one load, as `newton.solve` takes them."""

    def __init__(self, bending: Bending, load: float) -> None:
        self._bending, self._load = bending, load

    def residual(self, x: Vector) -> Vector:
        return self._bending.residual(x, self._load)

    def factorise(self, x: Vector) -> LinearSolver:
        return self._bending.factorise(x, self._load)
