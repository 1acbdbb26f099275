"""The factorised Jacobian of an anchor, rescaled to the stiffness of a run.

Let the run's solid be s times as stiff as the anchor's. Multiply by s the Jacobian's rows of momentum in fluid and
solid, and divide by s its columns of v, p and pₛ. In the solid and its constraint the result is the run's Jacobian: the
stress there is proportional to Young's modulus. In the fluid the derivatives by v and p are unchanged, and only those
by the moving geometry, which are weaker, are s times too large. So an anchor serves runs of very different stiffness.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.models.biofilm.linear import Factorisation
from strandline.models.biofilm.system import CoupledSystem

__all__ = ["Rescaled", "RowsAndColumns"]

Vector = Float[np.ndarray, " unknown"]


@dataclass(frozen=True, eq=False)
class RowsAndColumns:
    """Powers of the stiffness ratio by which rows and columns of the reduced Jacobian are multiplied."""

    rows: Vector
    columns: Vector

    @classmethod
    def of(cls, system: CoupledSystem) -> "RowsAndColumns":
        """Return those of a coupled system."""
        displacement, is_motion = system.block(2), system.is_motion[system.free]
        constraint = ~(system.block(0) | system.block(1) | displacement)
        return cls(1.0 - (is_motion | constraint), displacement - 1.0)


class Rescaled:
    """A factorised Jacobian for runs whose solid is `ratio` times as stiff.

    Args:
        factorised: The Jacobian of an anchor.
        powers: Rows and columns of the system.
        ratio: Shear modulus of the run by that of the anchor.
    """

    def __init__(self, factorised: Factorisation, powers: RowsAndColumns, ratio: float) -> None:
        self._factorised = factorised
        self._rows, self._columns = ratio**-powers.rows, ratio**-powers.columns

    def solve(self, right: Vector) -> Vector:
        """Return the correction."""
        return np.asarray(self._columns * self._factorised.solve(self._rows * right))
