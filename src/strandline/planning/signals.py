"""Predicted interfaces as signals: what an observation shows of them, in standard deviations of independent errors."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.linalg import cholesky

__all__ = ["signals_of"]

KEPT = 1e-3
"""Directions in which no displacement exceeds this share of the errors are left out."""


def signals_of(
    displacements: Float[np.ndarray, "draw point"],
    information: Callable[[Float[np.ndarray, "point some"]], Float[np.ndarray, "some some"]],
) -> Float[np.ndarray, "draw signal"]:
    """Return displacements as signals z, so that an observation of draw i is z_i + ε with standard normal ε.

    With errors of covariance C, what an observation tells about the displacements V c, which lie in a few directions V,
    is normal with mean c and covariance (Vᵀ C⁻¹ V)⁻¹.

    Args:
        displacements: Displacements of the observed points along their normals, for each draw of the inputs, mm.
        information: Function that returns Vᵀ C⁻¹ V of any directions V, 1/mm².
    """
    centred = displacements - displacements.mean(axis=0)
    _, sizes, directions = np.linalg.svd(centred, full_matrices=False)
    number = int((sizes > 1e-12 * max(float(sizes[0]), 1e-300)).sum())
    if number == 0:
        return np.zeros((len(centred), 1))
    basis = directions[:number].T
    root = cholesky(information(basis))
    signals = centred @ basis @ root.T
    # Rotate to the directions that the draws differ in most; the errors stay independent.
    _, spreads, axes = np.linalg.svd(signals, full_matrices=False)
    kept = spreads > KEPT * np.sqrt(len(signals))
    return np.asarray(signals @ axes[kept].T) if kept.any() else np.zeros((len(signals), 1))
