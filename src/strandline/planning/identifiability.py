"""Which combinations of the inputs an experiment can tell, from the Fisher information.

In inputs scaled by their prior standard deviations S, an experiment of Fisher information F leaves the covariance
(I + S F S)⁻¹ for a normal prior and an interface that is linear in the inputs. Its eigenvectors are the directions that
are learnt independently; the root of an eigenvalue is what is left of the prior's standard deviation there.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

__all__ = ["Direction", "directions_left", "directions_of", "in_words"]

NAMED = 0.3
"""Inputs with a smaller share of a direction than this, relative to the largest, are left out of its description."""


@dataclass(frozen=True, eq=False)
class Direction:
    """A combination of the inputs.

    Args:
        weights: Unit vector in inputs scaled by their prior standard deviations, shape (dim,).
        left: Share of the prior's standard deviation that is left in this direction.
    """

    weights: Float[np.ndarray, " dim"]
    left: float


def directions_left(
    sd: Float[np.ndarray, " dim"], informations: Sequence[Float[np.ndarray, "dim dim"]]
) -> tuple[Direction, ...]:
    """Return the combinations of the inputs, from the least to the best known after the experiment.

    Args:
        sd: Prior standard deviations of the inputs.
        informations: Fisher informations at draws of the prior; the covariance is averaged over them.
    """
    unit = np.eye(len(sd))
    left = np.mean([np.linalg.inv(unit + np.outer(sd, sd) * one) for one in informations], axis=0)
    return directions_of(np.asarray(left))


def directions_of(covariance: Float[np.ndarray, "dim dim"]) -> tuple[Direction, ...]:
    """Return the principal axes of a covariance of scaled inputs, the widest first."""
    values, vectors = np.linalg.eigh(covariance)
    roots = np.sqrt(np.maximum(values, 0.0))
    return tuple(Direction(_signed(vectors[:, k]), float(roots[k])) for k in np.argsort(-values))


def _signed(vector: Float[np.ndarray, " dim"]) -> Float[np.ndarray, " dim"]:
    """Return the vector, or its opposite, with a positive largest element."""
    return np.asarray(vector * np.sign(vector[np.argmax(np.abs(vector))]))


def in_words(direction: Direction, names: Sequence[str]) -> str:
    """Return a direction in words, e.g. ``E2 up and nu2 down (1 : 0.6)``, in prior standard deviations.

    Args:
        direction: The direction.
        names: Names of the inputs.
    """
    largest = float(np.abs(direction.weights).max())
    order = [k for k in np.argsort(-np.abs(direction.weights)) if abs(direction.weights[k]) >= NAMED * largest]
    moves = [f"{names[k]} {'up' if direction.weights[k] > 0 else 'down'}" for k in order]
    if len(moves) == 1:
        return names[order[0]]
    ratio = " : ".join(f"{abs(direction.weights[k]) / largest:.2g}" for k in order)
    return f"{', '.join(moves[:-1])} and {moves[-1]} ({ratio})"
