"""The interface in an experiment to be made, from one run of it and the surrogate of the present experiment.

What an input does to the interface there is nearly what it does here, times a factor. With the slopes J of the present
field in the inputs at x₀, and J' of the other one,

    y'(x) = y'(x₀) + A P Δ + a (I - P) Δ + (J' - A J) (u(x) - u(x₀)),   Δ = c(x) - c(x₀),

where c are the coefficients of the present modes, A = J' J⁺ takes slopes to slopes, P = J J⁺ projects onto what the
inputs do at x₀, a is the mean ratio of the slopes, and u are the inputs as the surrogate warps them. The
curvature of the present field is thus carried over. If the experiment is the present one, y' is its own surrogate.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.surrogate.field import FieldSurrogate

__all__ = ["Transferred", "transfer"]

STEP = 1e-3
"""Step of the differences of the present field, in widths of the box."""
WEAK = 1e-3
"""Directions of the inputs that move the present field by less than this share of the strongest are carried over by
their slopes alone."""


@dataclass(frozen=True, eq=False)
class Transferred:
    """The field of another experiment as a function of the inputs.

    Args:
        surrogate: Surrogate of the present field.
        at: Inputs of the run, shape (dim,).
        field: Field of the run, shape (value,), mm.
        by_modes: What the present coefficients do to it, shape (mode, value).
        by_inputs: What the warped inputs do besides, shape (dim, value), mm.
    """

    surrogate: FieldSurrogate
    at: Float[np.ndarray, " dim"]
    field: Float[np.ndarray, " value"]
    by_modes: Float[np.ndarray, "mode value"]
    by_inputs: Float[np.ndarray, "dim value"]

    def fields(self, x: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, "point value"]:
        """Return the field at inputs x, mm."""
        both = np.concatenate([self.at[None], x])
        coefficients, warped = self.surrogate.mean(both), self.surrogate.warping.standardise(both)
        by_modes = (coefficients[1:] - coefficients[0]) @ self.by_modes
        return np.asarray(self.field + by_modes + (warped[1:] - warped[0]) @ self.by_inputs)


def transfer(
    surrogate: FieldSurrogate,
    at: Float[np.ndarray, " dim"],
    field: Float[np.ndarray, " value"],
    slopes: Float[np.ndarray, "value dim"],
    covariance: Float[np.ndarray, "dim dim"],
) -> Transferred:
    """Return the field of another experiment from its value and its slopes at one point.

    Args:
        surrogate: Surrogate of the present field.
        at: Inputs of the run.
        field: Field of the run at the points of the surrogate, mm.
        slopes: Its derivatives in the physical inputs.
        covariance: Covariance of the inputs where the field will be used.
    """
    low, high = surrogate.warping.low, surrogate.warping.high
    steps = np.diag(STEP * (high - low))
    ahead, behind = np.clip(at + steps, low, high), np.clip(at - steps, low, high)
    coefficients = surrogate.mean(np.concatenate([ahead, behind]))
    here = ((coefficients[: len(at)] - coefficients[len(at) :]) / np.diag(ahead - behind)[:, None]).T
    root = np.linalg.cholesky(covariance)
    inverse = root @ np.linalg.pinv(here @ root, rcond=WEAK)
    carried = slopes @ inverse
    shapes = surrogate.modes.basis / surrogate.modes.roots
    typical = (here @ root).T @ shapes
    ratio = float(np.sum((slopes @ root).T * typical) / np.sum(typical**2))
    rest = ratio * (np.eye(len(here)) - here @ inverse)
    besides = slopes - carried @ here
    return Transferred(
        surrogate, at, field, carried.T + rest.T @ shapes, surrogate.warping.gradients(at[None], besides[None])[0].T
    )
