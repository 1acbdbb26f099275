"""Covariance matrices built, factorised and inverted in place; only lower triangles are touched."""

from collections.abc import Callable, Iterator

import numpy as np
from jaxtyping import Float
from scipy.linalg import lapack
from scipy.spatial.distance import cdist

from strandline.errors import NumericsError

__all__ = ["Panel", "distances", "factorise", "fill_lower", "invert", "lower_panels", "solve"]

Matrix = Float[np.ndarray, "run run"]
Panel = tuple[slice, slice]
_PANEL = 64


def distances(x: Float[np.ndarray, "run dim"]) -> Matrix:
    """Return the Euclidean distances of all pairs, in column-major order for LAPACK."""
    return np.asfortranarray(cdist(x, x))


def lower_panels(number: int, width: int = _PANEL) -> Iterator[Panel]:
    """Yield (rows, columns) of panels that cover the lower triangle and stay in the cache."""
    for start in range(0, number, width):
        yield slice(start, number), slice(start, min(start + width, number))


def fill_lower(out: Matrix, function: Callable[[Panel], Float[np.ndarray, "row column"]], *, diagonal: float) -> None:
    """Write function(panel) + diagonal·I into the lower triangle of `out`, panel by panel."""
    for panel in lower_panels(len(out)):
        out[panel] = function(panel)
    np.einsum("ii->i", out)[:] += diagonal


def factorise(K: Matrix) -> None:
    """Overwrite the lower triangle of K (column-major) by its Cholesky factor and clear the upper one.

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
    """Overwrite the Cholesky factor L (column-major) by the lower triangle of (L Lᵀ)⁻¹."""
    lapack.dpotri(L, lower=1, overwrite_c=1)


def solve(L: Matrix, y: Float[np.ndarray, " run"]) -> Float[np.ndarray, " run"]:
    """Return (L Lᵀ)⁻¹ y."""
    solution, _ = lapack.dpotrs(L, y, lower=1)
    return np.asarray(solution)
