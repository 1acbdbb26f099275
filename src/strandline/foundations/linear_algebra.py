"""Covariance matrices factorised and inverted in place; only lower triangles are touched."""

import numpy as np
from jaxtyping import Float
from scipy.linalg import lapack
from scipy.spatial.distance import cdist

from strandline.foundations.errors import NumericsError

Matrix = Float[np.ndarray, "run run"]


def distances(x: Float[np.ndarray, "run dim"]) -> Matrix:
    """Return the Euclidean distances of all pairs, in column-major order for LAPACK."""
    return np.asfortranarray(cdist(x, x))


def factorise(K: Matrix) -> None:
    """Overwrite the lower triangle of K (column-major) with its Cholesky factor and clear the upper one.

    Raises:
        NumericsError: K is not positive definite in floating point.
    """
    _, info = lapack.dpotrf(K, lower=1, clean=1, overwrite_a=1)
    if info != 0:
        raise NumericsError(
            f"the covariance of the {len(K)} training runs is not positive definite (minor {info}). "
            "Raise the nugget, bound the length scale lower, or clip extreme log-likelihoods."
        )


def invert(L: Matrix) -> None:
    """Overwrite the Cholesky factor L (column-major) with the lower triangle of (L Lᵀ)⁻¹."""
    lapack.dpotri(L, lower=1, overwrite_c=1)


def solve(L: Matrix, y: Float[np.ndarray, " run"]) -> Float[np.ndarray, " run"]:
    """Return (L Lᵀ)⁻¹ y."""
    solution, _ = lapack.dpotrs(L, y, lower=1)
    return np.asarray(solution)
