"""The residuals of all observations as a linear function of the inputs, at the inputs that fit best."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.stats import qmc

from strandline.interface import ErrorModel
from strandline.likelihood.joint_errors import JointErrors
from strandline.likelihood.near_field import NearField, near_field
from strandline.likelihood.residuals import sums_of
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
        slopes: Derivatives of the residuals in the inputs, shape (n, dim), mm per unit of the input.
        widths: Widths of the box of the inputs.
        field: The residuals as a function of the field there.
    """

    at: Float[np.ndarray, " dim"]
    slopes: Float[np.ndarray, "seen dim"]
    widths: Float[np.ndarray, " dim"]
    field: NearField

    @property
    def residuals(self) -> Float[np.ndarray, " seen"]:
        """Signed distances of all observed points at `at`, one observation after the other, mm."""
        return self.field.residuals

    @property
    def scaled(self) -> Float[np.ndarray, "seen dim"]:
        """What a standard deviation of a uniform prior over the box does to the residuals, mm."""
        return np.asarray(self.slopes * self.widths / np.sqrt(12.0))

    def covariance(self, model: ErrorModel) -> Float[np.ndarray, "dim dim"]:
        """Return the covariance of the inputs that errors of this covariance allow, without a prior."""
        return np.asarray(np.linalg.inv(model.information(self.slopes)))


def linearise(surrogate: FieldSurrogate, joint: JointErrors) -> Linearised:
    """Return the residuals around the inputs that fit best, by Gauss–Newton steps inside the box of the inputs.

    Args:
        surrogate: Surrogate of the field.
        joint: The observed interfaces with the errors of their points, to weigh the residuals.
    """
    low, high = surrogate.warping.low, surrogate.warping.high
    widths, model = high - low, joint.model
    templates = {name: layout.template for name, layout in surrogate.layouts.items()}

    def around(x: Float[np.ndarray, " dim"]) -> tuple[NearField, Float[np.ndarray, "seen dim"]]:
        step = _DIFFERENCE * widths * np.where(x + _DIFFERENCE * widths > high, -1.0, 1.0)
        coefficients = surrogate.mean(x + np.vstack([np.zeros(len(x)), np.diag(step)]))
        field = near_field(surrogate, joint, coefficients[0], linear=True)
        return field, field.slopes @ ((coefficients[1:] - coefficients[0]) / step[:, None]).T

    tried = low + widths * qmc.Sobol(len(low), seed=np.random.default_rng(0)).random(TRIED)
    squares = model.square_of(*sums_of(joint, surrogate.points(surrogate.mean(tried)), templates))
    x = tried[int(np.argmin(squares))]
    field, J = around(x)
    for _ in range(STEPS):
        r = field.residuals
        moved = _step(x, r, J, model, low, high)
        if (np.abs(moved - x) <= 1e-6 * widths).all():
            break
        for share in SHARES:
            field_moved, J_moved = around(x + share * (moved - x))
            if model.square(field_moved.residuals) < model.square(r):
                break
        else:
            break
        x, field, J = x + share * (moved - x), field_moved, J_moved
    return Linearised(x, J, widths, near_field(surrogate, joint, field.at))


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
