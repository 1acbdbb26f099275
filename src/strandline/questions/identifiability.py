"""Which combinations of the inputs an experiment can determine, from the Fisher information.

Inputs u are scaled by their prior standard deviations. Positive ones enter by their logarithms, since a common factor
of stiffness and load changes no shape, whatever their size. An experiment of Fisher information F leaves the covariance
(I + F)⁻¹ of u for a normal prior and an interface that is linear in u. Its eigenvectors are the combinations that are
learnt independently; the root of an eigenvalue is what is left of the prior's standard deviation there.

Combinations about which hardly anything is learnt are equally unknown, so any rotation of them is as good. The one with
the fewest inputs in each is chosen (varimax; Kaiser 1958).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from strandline.parameters import ParameterSpace

HARDLY = 0.85
"""Share of the prior's standard deviation above which hardly anything was learnt about a combination."""
NAMED = 0.3
"""Inputs with a smaller share of a combination than this, relative to the largest, are left out of its description."""
ROTATIONS = 200
QUANTILES = 1000


@dataclass(frozen=True, eq=False)
class Scale:
    """How inputs are scaled: which enter by their logarithm, and the prior standard deviations of these or of the
    inputs.
    """

    logarithmic: Bool[np.ndarray, " dim"]
    sd: Float[np.ndarray, " dim"]

    def of(self, x: Float[np.ndarray, "draw dim"]) -> Float[np.ndarray, "draw dim"]:
        """Return u at physical inputs."""
        return np.asarray(np.where(self.logarithmic, np.log(np.where(self.logarithmic, x, 1.0)), x) / self.sd)

    def factors(self, x: Float[np.ndarray, " dim"]) -> Float[np.ndarray, " dim"]:
        """Return dx/du at physical inputs."""
        return np.asarray(np.where(self.logarithmic, x, 1.0) * self.sd)


def scale_of(space: ParameterSpace) -> Scale:
    """Return the scale of the inputs of a study; those whose box has no negative values enter by their logarithms."""
    logarithmic = space.low >= 0
    p = (np.arange(QUANTILES) + 0.5) / QUANTILES
    draws = Scale(logarithmic, np.ones(space.dim)).of(space.prior_quantiles(np.repeat(p[:, None], space.dim, axis=1)))
    return Scale(logarithmic, np.asarray(draws.std(axis=0)))


@dataclass(frozen=True, eq=False)
class Direction:
    """A combination of the inputs, a unit vector in scaled inputs, and the share of the prior's sd left in it."""

    weights: Float[np.ndarray, " dim"]
    left: float


def directions_left(
    scale: Scale, x: Float[np.ndarray, "draw dim"], informations: Sequence[Float[np.ndarray, "dim dim"]]
) -> tuple[Direction, ...]:
    """Return the combinations of the inputs, from the least to the best known after the experiment.

    The covariance is averaged over draws `x` of the prior, with the Fisher information of the physical inputs at each.
    """
    factors = [scale.factors(row) for row in x]
    unit = np.eye(x.shape[1])
    left = [np.linalg.inv(unit + np.outer(f, f) * one) for f, one in zip(factors, informations, strict=True)]
    return directions_of(np.asarray(np.mean(left, axis=0)))


def directions_of(covariance: Float[np.ndarray, "dim dim"]) -> tuple[Direction, ...]:
    """Return the principal axes of a covariance of scaled inputs, the widest first; the unknown ones rotated."""
    values, vectors = np.linalg.eigh(covariance)
    unknown = values > HARDLY**2
    axes = np.hstack([_varimax(vectors[:, unknown]), vectors[:, ~unknown]])
    left = np.sqrt(np.maximum(np.einsum("ik,ij,jk->k", axes, covariance, axes), 0.0))
    return tuple(Direction(_signed(axes[:, k]), float(left[k])) for k in np.argsort(-left))


def _varimax(axes: Float[np.ndarray, "dim axis"]) -> Float[np.ndarray, "dim axis"]:
    """Return the rotation of orthonormal axes whose squared elements vary most, so that each has few large ones."""
    turn = np.eye(axes.shape[1])
    for _ in range(ROTATIONS if axes.shape[1] > 1 else 0):
        turned = axes @ turn
        u, _, vt = np.linalg.svd(axes.T @ (turned**3 - turned * (turned**2).mean(axis=0)))
        turn = u @ vt
    return np.asarray(axes @ turn)


def _signed(vector: Float[np.ndarray, " dim"]) -> Float[np.ndarray, " dim"]:
    """Return the vector, or its opposite, with a positive largest element."""
    return np.asarray(vector * np.sign(vector[np.argmax(np.abs(vector))]))


def in_words(direction: Direction, names: Sequence[str]) -> str:
    """Return a direction in words, e.g. ``E2 up and nu2 down (1 : 0.6)``, in prior standard deviations."""
    largest = float(np.abs(direction.weights).max())
    sizes = np.round(np.abs(direction.weights), 6)
    order = [k for k in np.argsort(-sizes, kind="stable") if sizes[k] >= NAMED * largest]
    if len(order) == 1:
        return str(names[order[0]])
    moves = [f"{names[k]} {'up' if direction.weights[k] > 0 else 'down'}" for k in order]
    ratio = " : ".join(f"{abs(direction.weights[k]) / largest:.2g}" for k in order)
    return f"{', '.join(moves[:-1])} and {moves[-1]} ({ratio})"
