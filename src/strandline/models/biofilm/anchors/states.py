"""Anchors: the steady states at fixed points of a box, and what they tell of a run between them.

Cubic radial basis functions with a linear part interpolate all unknowns, so no reduced basis is needed: with a proper
orthogonal decomposition that keeps every mode the result is the same. The anchors depend on the geometry, the options
and the box alone, never on the runs of a study, so a run's result depends on its inputs alone.
"""

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import RBFInterpolator

from strandline.errors import ForwardModelError
from strandline.models.biofilm.anchors.box import Box

__all__ = ["States"]

Vector = Float[np.ndarray, " unknown"]


@dataclass(frozen=True, eq=False)
class States:
    """What was found at the points of a box.

    Args:
        coordinates: Points whose first-order state was found (point, axis).
        strains: Largest compressive strain of the first-order state at each (point,).
        solved: Which points have a steady state (point,).
        unknowns: The steady states (solved point, unknown), scaled.
    """

    coordinates: Float[np.ndarray, "point axis"]
    strains: Float[np.ndarray, " point"]
    solved: Bool[np.ndarray, " point"]
    unknowns: Float[np.ndarray, "solved unknown"]

    @property
    def anchors(self) -> Float[np.ndarray, "solved axis"]:
        """Coordinates of the steady states."""
        return np.asarray(self.coordinates[self.solved])

    @property
    def suffice(self) -> bool:
        """Whether there are enough steady states to interpolate."""
        axes = self.coordinates.shape[1]
        enough = len(self.anchors) > axes + 1
        return bool(enough and np.linalg.matrix_rank(self.anchors - self.anchors.mean(0)) == axes)

    def strain(self, at: Float[np.ndarray, " axis"]) -> float:
        """Return the predicted strain of the first-order state."""
        return float(np.exp(self._strain(at[None])[0]))

    def guess(self, at: Float[np.ndarray, " axis"]) -> Vector:
        """Return the predicted steady state, scaled."""
        return np.asarray(self._state(at[None])[0])

    @cached_property
    def _strain(self) -> RBFInterpolator:
        return RBFInterpolator(self.coordinates, np.log(self.strains), kernel="cubic", degree=1)

    @cached_property
    def _state(self) -> RBFInterpolator:
        return RBFInterpolator(self.anchors, self.unknowns, kernel="cubic", degree=1)

    @classmethod
    def solve(
        cls,
        box: Box,
        first_order_strain: Callable[[Mapping[str, float]], float],
        steady_state: Callable[[Mapping[str, float]], Vector],
        largest_strain: float,
    ) -> "States":
        """Return the states at the points of a box; where it bends too far, or the run fails, there is no anchor.

        Args:
            box: The box.
            first_order_strain: Largest compressive strain of the first-order state, by inputs.
            steady_state: Unknowns of the steady state, by inputs.
            largest_strain: Largest strain of the first-order state with which a steady state is solved.
        """
        points: list[tuple[float, ...]] = []
        strains: list[float] = []
        found: list[Vector | None] = []
        for point in box.points():
            with contextlib.suppress(ForwardModelError):
                strain = first_order_strain(box.inputs(point))
                points.append(point)
                strains.append(max(strain, np.finfo(float).tiny))
                found.append(None)
                if strain <= largest_strain:
                    found[-1] = steady_state(box.inputs(point))
        solved = [x for x in found if x is not None]
        return cls(
            np.array(points).reshape(len(points), len(box.axes)),
            np.array(strains),
            np.array([x is not None for x in found], dtype=bool),
            np.array(solved) if solved else np.empty((0, 0)),
        )
