"""A Gaussian process of one coefficient of the field, conditioned on values and, if available, on gradients.

The kernel is the squared exponential for a function and its gradient, in coordinates scaled by the length scales. With
δ = u - v and k = exp(-|δ|²/2): cov(f, f') = k, cov(f, ∂_j f') = k δ_j, cov(∂_i f, ∂_j f') = k (I_ij - δ_i δ_j);
Rasmussen and Williams (2006), Section 9.4. Rows and columns: all values, then the derivatives by the first coordinate,
by the second, and so on.

y = F b + f + noise with f of covariance s² K, noise of variance s² τ and a flat prior on b. Hyperparameters maximise
the restricted likelihood (Patterson and Thompson 1971; Rasmussen and Williams 2006, Eq. 2.45), profiled over s². Their
coordinates are the logarithms of the length scales, and of τ.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import cholesky, lapack, solve_triangular
from scipy.optimize import minimize
from scipy.spatial.distance import cdist

from strandline.foundations import NumericsError

Points = Float[np.ndarray, "point dim"]
Inputs = Float[np.ndarray, "run dim"]
Lengths = Float[np.ndarray, " dim"]
Coordinates = Float[np.ndarray, " coordinate"]

LENGTHS = (0.2, 40.0)  # bounds of the length scales, in standard deviations of the inputs over the box
NUGGETS = (1e-10, 1e-2)  # bounds of the noise variance, relative to that of the process
TYPICAL_LENGTH, LENGTH_SPREAD = 3.0, 1.5
"""Median and spread, in logarithms, of the prior of a length scale: it decides if too few runs do."""
STARTS = (3.0, 1.0)
SHORT_START, NOISY = 0.3, 1e-3
"""A last start, made if the others ended with at least this nugget: they may have taken a fast response for scatter."""
_STARTING_NUGGET = 1e-6
_ITERATIONS = 40
_LARGE = 120  # observations from which a single start is made
_ENOUGH = 1000
"""Observations from which hyperparameters are learnt: 2000 runs take 66 CPU-seconds for three modes, by a thousand of
these 10. Errors elsewhere grew by at most a fifth (a smooth model, a kink, a ridge; 1200 runs)."""
_QUICK_ITERATIONS = 15
_PRIOR_RUNS = 4.0  # weight of "the variances are right" against the residuals
_WALL = 1e25


def covariance(
    u: Inputs, v: Float[np.ndarray, "other dim"], *, rows: bool, columns: bool
) -> Float[np.ndarray, "row column"]:
    """Return the covariance of unit variance between observations at `u` and at `v`.

    With `rows`, the values at `u` are followed by derivatives with respect to the scaled coordinates; with `columns`,
    those at `v`.
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


def trend(z: Inputs, lengths: Lengths, *, linear: bool, derivatives: bool) -> Float[np.ndarray, "row term"]:
    """Return the terms of the mean, 1 and, if `linear`, the inputs, and if asked their derivatives by z/lengths."""
    n, dim = z.shape
    F = np.zeros((n * (1 + dim * derivatives), 1 + dim * linear))
    F[:n, 0] = 1.0
    if linear:
        F[:n, 1:] = z
        for j in range(dim if derivatives else 0):
            F[(j + 1) * n : (j + 2) * n, 1 + j] = lengths[j]
    return F


@dataclass(frozen=True, eq=False)
class ModeData:
    """Data on one function of standardised inputs: values, and derivatives with respect to these inputs if available;
    its mean is linear in the inputs, or constant.
    """

    z: Inputs
    values: Float[np.ndarray, " run"]
    gradients: Inputs | None
    linear: bool

    def thinned(self) -> "ModeData":
        """Return the data of runs by equal strides that have `_ENOUGH` observations; all if they have fewer."""
        rows = 1 if self.gradients is None else 1 + self.z.shape[1]
        kept = max(_ENOUGH // rows, 1)
        if len(self.z) <= kept:
            return self
        at = np.linspace(0, len(self.z) - 1, kept).astype(int)
        gradients = None if self.gradients is None else self.gradients[at]
        return ModeData(self.z[at], self.values[at], gradients, self.linear)

    def scaled(self, lengths: Lengths) -> Float[np.ndarray, " row"]:
        """Return values, and derivatives with respect to the inputs in length scales, in one column."""
        if self.gradients is None:
            return self.values
        return np.concatenate([self.values, (self.gradients * lengths).T.ravel()])


@dataclass(frozen=True, eq=False)
class Conditioned:
    """Factors of a process with given hyperparameters; N observations, p terms of the mean.

    These are the lower factor of K + τ I, the terms F of the mean at the observations, (K + τ I)⁻¹ F, the normal matrix
    Fᵀ (K + τ I)⁻¹ F, the coefficients b of the mean, the residual y - F b, alpha = (K + τ I)⁻¹ residual, and the
    variance s² of the process.
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


def condition_mode(observed: ModeData, lengths: Lengths, nugget: float) -> Conditioned:
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


def restricted_evidence(observed: ModeData, log_lengths: Lengths, log_nugget: float) -> tuple[float, Coordinates]:
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


def _by_kernel(observed: ModeData, W: Float[np.ndarray, "row row"], lengths: Lengths, nugget: float) -> Coordinates:
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


@dataclass(frozen=True, eq=False)
class LeftOutErrors:
    """Each run predicted from all others: error of the value, and its variance by the process (run,)."""

    errors: Float[np.ndarray, " run"]
    variances: Float[np.ndarray, " run"]


@dataclass(frozen=True, eq=False)
class ModeProcess:
    """The process of one coefficient; inputs of all methods are standardised.

    Length scales are in standard deviations of the inputs, the nugget is relative to the variance of the process.
    `widening` is a factor of all variances, at least 1, by which the errors of left-out runs exceed what they should
    be.
    """

    observed: ModeData
    lengths: Lengths
    nugget: float
    factors: Conditioned
    widening: float = 1.0

    def mean(self, z: Points) -> Float[np.ndarray, " point"]:
        """Return the posterior mean; derivatives add k (u - v)·β, by matrix products for all but the exponential."""
        u, v, alpha = z / self.lengths, self.observed.z / self.lengths, self.factors.alpha
        n, dim = v.shape
        exponent = u @ v.T
        exponent -= 0.5 * np.einsum("pd,pd->p", u, u)[:, None]
        exponent -= 0.5 * np.einsum("rd,rd->r", v, v)
        k = np.exp(exponent, out=exponent)
        if self.observed.gradients is None:
            found = k @ alpha
        else:
            slopes = alpha[n:].reshape(dim, n)
            weights = u @ slopes
            weights += alpha[:n] - np.einsum("rd,dr->r", v, slopes)
            found = np.einsum("pr,pr->p", k, weights)
        return np.asarray(found + self._trend(z) @ self.factors.coefficients)

    def variance(self, z: Points) -> Float[np.ndarray, " point"]:
        """Return the posterior variance of the coefficient, including the uncertainty of its mean function."""
        half, of_mean = self._reduced(z)
        explained = np.einsum("rp,rp->p", half, half) - np.einsum("tp,tp->p", of_mean, of_mean)
        return np.asarray(self.scale * np.maximum(1.0 - explained, 0.0))

    def covariance(self, z: Points, other: Float[np.ndarray, "other dim"]) -> Float[np.ndarray, "point other"]:
        """Return the posterior covariance of the coefficient at two sets of inputs."""
        (a, a_mean), (b, b_mean) = self._reduced(z), self._reduced(other)
        prior = covariance(z / self.lengths, other / self.lengths, rows=False, columns=False)
        return np.asarray(self.scale * (prior - a.T @ b + a_mean.T @ b_mean))

    @property
    def scale(self) -> float:
        """Variance of the process before any run."""
        return self.factors.variance * self.widening

    def left_out(self) -> LeftOutErrors:
        """Return the errors of leave-one-run-out prediction; its gradient is left out with its value.

        Closed form with the precision matrix: Rasmussen and Williams (2006), Section 5.4.2, in blocks.
        """
        n, P = len(self.observed.z), self.factors.precision
        rows = np.arange(len(P)).reshape(-1, n).T
        blocks = np.linalg.inv(P[rows[:, :, None], rows[:, None, :]])
        errors = np.einsum("nk,nk->n", blocks[:, 0], self.factors.alpha[rows])
        return LeftOutErrors(errors, self.scale * blocks[:, 0, 0])

    def _trend(self, z: Points) -> Float[np.ndarray, "point term"]:
        return trend(z, self.lengths, linear=self.observed.linear, derivatives=False)

    def _reduced(self, z: Points) -> tuple[Float[np.ndarray, "row point"], Float[np.ndarray, "term point"]]:
        """Return roots of the variance at z that the runs explain and of the part that the unknown mean adds."""
        u, v, gradients = z / self.lengths, self.observed.z / self.lengths, self.observed.gradients is not None
        rows = covariance(u, v, rows=False, columns=gradients)
        half = solve_triangular(self.factors.cholesky, rows.T, lower=True, check_finite=False)
        unexplained = self._trend(z) - rows @ self.factors.solved_trend
        root = np.linalg.cholesky(self.factors.normal)
        return half, np.asarray(solve_triangular(root, unexplained.T, lower=True, check_finite=False))


def fit_mode(observed: ModeData, *, quick: bool = False) -> ModeProcess:
    """Return the process whose length scales and nugget maximise the restricted evidence and their weak prior.

    With `quick`, there are one start and few iterations, for comparisons.

    Raises:
        NumericsError: No start of the optimiser led to hyperparameters with a covariance that can be factorised.
    """
    dim = observed.z.shape[1]
    box = [tuple(map(math.log, LENGTHS))] * dim + [tuple(map(math.log, NUGGETS))]
    rows = len(observed.z) * (1 if observed.gradients is None else 1 + dim)
    best, noisy, learnt = None, math.log(NOISY), observed.thinned()
    for start in (*STARTS[: 1 if quick or rows > _LARGE else None], SHORT_START):
        if start == SHORT_START and best is not None and best.x[dim] < noisy:
            break
        at = np.array([math.log(start)] * dim + [math.log(_STARTING_NUGGET)])
        limit = {"maxiter": _QUICK_ITERATIONS if quick else _ITERATIONS}
        found = minimize(_objective, at, args=(learnt,), jac=True, method="L-BFGS-B", bounds=box, options=limit)
        if found.fun < _WALL and (best is None or found.fun < best.fun):
            best = found
    if best is None:
        raise NumericsError("no length scales were found for a mode of the field: do repeated runs differ?")
    lengths, nugget = np.exp(best.x[:dim]), float(np.exp(best.x[dim]))
    process = ModeProcess(observed, lengths, nugget, condition_mode(observed, lengths, nugget))
    left_out = process.left_out()
    surprise = float(np.sum(left_out.errors**2 / np.maximum(left_out.variances, 1e-300)))
    return replace(process, widening=max(1.0, (surprise + _PRIOR_RUNS) / (len(observed.z) + _PRIOR_RUNS)))


def _objective(at: Coordinates, observed: ModeData) -> tuple[float, Coordinates]:
    """Return minus the log evidence and minus the log prior of the lengths; a wall if there is no evidence."""
    dim = len(at) - 1
    try:
        value, slope = restricted_evidence(observed, at[:dim], float(at[dim]))
    except NumericsError:
        return 2 * _WALL, np.zeros(len(at))
    off = (at[:dim] - math.log(TYPICAL_LENGTH)) / LENGTH_SPREAD
    prior = np.append(off / LENGTH_SPREAD, 0.0)
    return -value + 0.5 * float(off @ off), prior - slope
