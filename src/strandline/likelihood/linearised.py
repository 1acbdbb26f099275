"""The residuals of all observations as a linear function of the inputs, at the inputs that fit best."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.stats import qmc

from strandline.interface import ErrorModel, Observation, PointErrors
from strandline.likelihood.joint_errors import JointErrors
from strandline.likelihood.residuals import residuals_of
from strandline.surrogate.field import FieldSurrogate

__all__ = ["Linearised", "linearise"]

TRIED = 256
"""Inputs tried before the first step."""
STEPS = 12
SHARES = (1.0, 0.5, 0.25, 0.1)
"""Shares of a Gauss–Newton step that are tried until one fits better."""
_DIFFERENCE = 1e-3
"""Step of the finite differences, in widths of the box."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """r(x) ≈ residuals + slopes (x - at).

    Args:
        at: The inputs that fit best, shape (dim,).
        residuals: Signed distances of all observed points at these inputs, one observation after the other, mm.
        slopes: Their derivatives, shape (n, dim), mm per unit of the input.
        widths: Widths of the box of the inputs.
    """

    at: Float[np.ndarray, " dim"]
    residuals: Float[np.ndarray, " seen"]
    slopes: Float[np.ndarray, "seen dim"]
    widths: Float[np.ndarray, " dim"]

    @property
    def scaled(self) -> Float[np.ndarray, "seen dim"]:
        """What a standard deviation of a uniform prior over the box does to the residuals, mm."""
        return np.asarray(self.slopes * self.widths / np.sqrt(12.0))

    def covariance(self, model: ErrorModel) -> Float[np.ndarray, "dim dim"]:
        """Return the covariance of the inputs that errors of this covariance allow, without a prior."""
        return np.asarray(np.linalg.inv(model.information(self.slopes)))


def linearise(
    surrogate: FieldSurrogate, observations: Sequence[Observation], errors: Sequence[PointErrors]
) -> Linearised:
    """Return the residuals around the inputs that fit best, by Gauss–Newton steps inside the box of the inputs.

    Args:
        surrogate: Surrogate of the field.
        observations: The observed interfaces.
        errors: Errors of the points of each, to weigh the residuals.
    """
    low, high = surrogate.warping.low, surrogate.warping.high
    joint, widths = JointErrors(tuple(observations), tuple(errors)), high - low
    model = joint.model
    templates = {name: layout.template for name, layout in surrogate.layouts.items()}

    def residuals(x: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, "point seen"]:
        return residuals_of(joint, surrogate.points(surrogate.mean(x)), templates)

    def around(x: Float[np.ndarray, " dim"]) -> tuple[Float[np.ndarray, " seen"], Float[np.ndarray, "seen dim"]]:
        step = _DIFFERENCE * widths * np.where(x + _DIFFERENCE * widths > high, -1.0, 1.0)
        found = residuals(x + np.vstack([np.zeros(len(x)), np.diag(step)]))
        return found[0], ((found[1:] - found[0]) / step[:, None]).T

    tried = low + widths * qmc.Sobol(len(low), seed=np.random.default_rng(0)).random(TRIED)
    x = tried[int(np.argmin(model.square(residuals(tried))))]
    r, J = around(x)
    for _ in range(STEPS):
        moved = _step(x, r, J, model, low, high)
        if (np.abs(moved - x) <= 1e-6 * widths).all():
            break
        for share in SHARES:
            r_moved, J_moved = around(x + share * (moved - x))
            if model.square(r_moved) < model.square(r):
                break
        else:
            break
        x, r, J = x + share * (moved - x), r_moved, J_moved
    return Linearised(x, r, J, widths)


def _step(
    x: Float[np.ndarray, " dim"],
    r: Float[np.ndarray, " seen"],
    J: Float[np.ndarray, "seen dim"],
    model: ErrorModel,
    low: Float[np.ndarray, " dim"],
    high: Float[np.ndarray, " dim"],
) -> Float[np.ndarray, " dim"]:
    """Return the next inputs; a weak prior over the box keeps inputs in place that the data do not tell."""
    weak = np.diag(1e-6 * 12 / (high - low) ** 2)
    return np.asarray(np.clip(x - np.linalg.solve(model.information(J) + weak, J.T @ model.solved(r)), low, high))
