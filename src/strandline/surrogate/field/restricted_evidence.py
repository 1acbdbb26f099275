"""Evidence of a mode's process, with its mean integrated out and its variance profiled, and its gradient.

y = F b + f + noise with f of covariance s² K, noise of variance s² τ and a flat prior on b: the restricted likelihood
(Patterson and Thompson 1971; Rasmussen and Williams 2006, Eq. 2.45), profiled over s². Coordinates are the logarithms
of the length scales, and of τ.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import cholesky, lapack, solve_triangular

from strandline.errors import NumericsError
from strandline.surrogate.field.derivative_kernel import covariance, trend

__all__ = ["Conditioned", "Observed", "condition_mode", "restricted_evidence"]


@dataclass(frozen=True, eq=False)
class Observed:
    """Data on one function: values, and gradients if available.

    Args:
        z: Inputs, standardised (run, dim).
        values: Values of the function (run,).
        gradients: Derivatives with respect to the standardised inputs (run, dim), or None.
        linear: Whether the mean is linear in the inputs or constant.
    """

    z: Float[np.ndarray, "run dim"]
    values: Float[np.ndarray, " run"]
    gradients: Float[np.ndarray, "run dim"] | None
    linear: bool

    def scaled(self, lengths: Float[np.ndarray, " dim"]) -> Float[np.ndarray, " row"]:
        """Return values, and derivatives with respect to the inputs in length scales, in one column."""
        if self.gradients is None:
            return self.values
        return np.concatenate([self.values, (self.gradients * lengths).T.ravel()])


@dataclass(frozen=True, eq=False)
class Conditioned:
    """Factors of a process with given hyperparameters; N observations, p terms of the mean.

    Args:
        cholesky: Lower factor of K + τ I.
        trend: Terms F of the mean at the observations.
        solved_trend: Solution (K + τ I)⁻¹ F.
        normal: Normal matrix Fᵀ (K + τ I)⁻¹ F.
        coefficients: Coefficients b of the mean.
        residual: Residual y - F b.
        alpha: Solution (K + τ I)⁻¹ residual.
        variance: Variance s² of the process.
    """

    cholesky: Float[np.ndarray, "row row"]
    trend: Float[np.ndarray, "row term"]
    solved_trend: Float[np.ndarray, "row term"]
    normal: Float[np.ndarray, "term term"]
    coefficients: Float[np.ndarray, " term"]
    residual: Float[np.ndarray, " row"]
    alpha: Float[np.ndarray, " row"]
    variance: float

    @property
    def precision(self) -> Float[np.ndarray, "row row"]:
        """(K + τ I)⁻¹ less the part due to the unknown mean: P = K⁻¹ - K⁻¹F (FᵀK⁻¹F)⁻¹ FᵀK⁻¹."""
        inverse, _ = lapack.dpotri(self.cholesky, lower=1)
        inverse = np.tril(inverse) + np.tril(inverse, -1).T
        return np.asarray(inverse - self.solved_trend @ np.linalg.solve(self.normal, self.solved_trend.T))


def condition_mode(observed: Observed, lengths: Float[np.ndarray, " dim"], nugget: float) -> Conditioned:
    """Return the factors at given length scales (standardised inputs) and relative nugget τ.

    Raises:
        NumericsError: the covariance is not positive definite.
    """
    derivatives = observed.gradients is not None
    u = observed.z / lengths
    K = covariance(u, u, rows=derivatives, columns=derivatives)
    K[np.diag_indices_from(K)] += nugget
    F, y = trend(observed.z, lengths, linear=observed.linear, derivatives=derivatives), observed.scaled(lengths)
    try:
        L = cholesky(K, lower=True, overwrite_a=True, check_finite=False)
    except np.linalg.LinAlgError as error:
        raise NumericsError("the covariance of a mode is not positive definite; raise its nugget") from error
    half, right = (solve_triangular(L, a, lower=True, check_finite=False) for a in (F, y))
    normal = half.T @ half
    b = np.linalg.lstsq(half, right, rcond=None)[0]
    residual, white = y - F @ b, right - half @ b
    alpha, solved = (solve_triangular(L, a, lower=True, trans="T", check_finite=False) for a in (white, half))
    freedom = max(len(y) - F.shape[1], 1)
    return Conditioned(L, F, solved, normal, b, residual, alpha, float(white @ white) / freedom)


def restricted_evidence(
    observed: Observed, log_lengths: Float[np.ndarray, " dim"], log_nugget: float
) -> tuple[float, Float[np.ndarray, " coordinate"]]:
    """Return the log evidence, up to a constant, and its gradient with respect to log lengths and log nugget.

    Raises:
        NumericsError: the covariance is not positive definite, or the data leave no residual.
    """
    lengths, nugget = np.exp(log_lengths), float(np.exp(log_nugget))
    c = condition_mode(observed, lengths, nugget)
    if not c.variance > 0:
        raise NumericsError("a mode without variation beyond its mean has no evidence")
    n, dim = observed.z.shape
    rows, terms = c.trend.shape
    freedom = rows - terms
    sign = np.linalg.slogdet(c.normal)[1]
    value = -0.5 * freedom * np.log(c.variance) - np.log(np.diagonal(c.cholesky)).sum() - 0.5 * sign
    W = c.precision - np.outer(c.alpha, c.alpha) / c.variance
    slope = -0.5 * _by_kernel(observed, W, lengths, nugget)
    for j in range(dim if observed.gradients is not None else 0):
        mine = slice((j + 1) * n, (j + 2) * n)
        of_mean = np.trace(np.linalg.solve(c.normal, c.trend[mine].T @ c.solved_trend[mine]))
        slope[j] += n - float(c.alpha[mine] @ c.residual[mine]) / c.variance - float(of_mean)
        value += n * float(log_lengths[j])
    return float(value), slope


def _by_kernel(
    observed: Observed, W: Float[np.ndarray, "row row"], lengths: Float[np.ndarray, " dim"], nugget: float
) -> Float[np.ndarray, " coordinate"]:
    """Return Σ W_ab ∂(K + τ I)_ab by each log length and by log τ, with derivatives by the scaled coordinates."""
    (n, dim), derivatives = observed.z.shape, observed.gradients is not None
    u = observed.z / lengths
    K = covariance(u, u, rows=derivatives, columns=derivatives)
    Q, blocks = W * K, len(W) // n
    values = Q.reshape(blocks, n, blocks, n).sum(axis=(0, 2))
    out = np.empty(dim + 1)
    for j in range(dim):
        squares = (u[:, None, j] - u[:, j]) ** 2
        out[j] = np.einsum("nm,nm->", values, squares)
        if derivatives:
            mine = slice((j + 1) * n, (j + 2) * n)
            out[j] += 2.0 * (np.einsum("nm,nm->", W[mine, mine], K[:n, :n]) - Q[mine].sum())
    out[dim] = nugget * np.trace(W)
    return out
