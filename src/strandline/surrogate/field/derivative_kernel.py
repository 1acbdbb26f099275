"""The squared exponential for a function and its gradient, in coordinates scaled by the length scales.

With δ = u - v and k = exp(-|δ|²/2): cov(f, f') = k, cov(f, ∂_j f') = k δ_j, cov(∂_i f, ∂_j f') = k (I_ij - δ_i δ_j);
Rasmussen and Williams (2006), Section 9.4. Rows and columns: all values, then the derivatives by the first coordinate,
by the second, and so on.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import cdist

__all__ = ["covariance", "trend"]


def covariance(
    u: Float[np.ndarray, "run dim"], v: Float[np.ndarray, "other dim"], *, rows: bool, columns: bool
) -> Float[np.ndarray, "row column"]:
    """Return the covariance of unit variance between observations at `u` and at `v`.

    Args:
        u: inputs in length scales.
        v: inputs in length scales.
        rows: whether derivatives at `u` with respect to the scaled coordinates follow the values.
        columns: the same at `v`.
    """
    (n, dim), m = u.shape, len(v)
    k = np.asarray(np.exp(-0.5 * cdist(u, v, "sqeuclidean")))
    if not (rows or columns):
        return k
    K = np.empty((n * (1 + dim * rows), m * (1 + dim * columns)))
    K[:n, :m] = k
    delta = [u[:, j, None] - v[:, j] for j in range(dim)]
    for j in range(dim):
        here, there = slice((j + 1) * n, (j + 2) * n), slice((j + 1) * m, (j + 2) * m)
        by = k * delta[j]
        if columns:
            K[:n, there] = by
        if rows:
            K[here, :m] = -by
            for i in range(dim) if columns else ():
                block = np.multiply(by, delta[i], out=K[here, (i + 1) * m : (i + 2) * m])
                np.subtract(k if i == j else 0.0, block, out=block)
    return K


def trend(
    z: Float[np.ndarray, "run dim"], lengths: Float[np.ndarray, " dim"], *, linear: bool, derivatives: bool
) -> Float[np.ndarray, "row term"]:
    """Return the terms of the mean, 1 and, if `linear`, the inputs, and if asked their derivatives by z/lengths."""
    n, dim = z.shape
    F = np.zeros((n * (1 + dim * derivatives), 1 + dim * linear))
    F[:n, 0] = 1.0
    if linear:
        F[:n, 1:] = z
        for j in range(dim if derivatives else 0):
            F[(j + 1) * n : (j + 2) * n, 1 + j] = lengths[j]
    return F
