"""Draws moved to a wanted covariance."""

import numpy as np
from jaxtyping import Float

__all__ = ["matched"]

TINY = 1e-300


def matched(of: Float[np.ndarray, "dim dim"], wanted: Float[np.ndarray, "dim dim"]) -> Float[np.ndarray, "dim dim"]:
    """Return the matrix that gives row vectors of covariance `of` the covariance `wanted`; the unit one if singular."""
    scale = np.sqrt(np.maximum(np.diag(wanted), TINY))
    try:
        first = np.linalg.cholesky(of / np.outer(scale, scale))
        second = np.linalg.cholesky(wanted / np.outer(scale, scale))
    except np.linalg.LinAlgError:
        return np.eye(len(scale))
    return np.asarray(np.linalg.solve(first.T, second.T) * scale / scale[:, None])
