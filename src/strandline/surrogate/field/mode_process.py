"""A Gaussian process of one coefficient of the field, conditioned on values and, if available, on gradients."""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular
from scipy.optimize import minimize

from strandline.errors import NumericsError
from strandline.surrogate.field.derivative_kernel import covariance, trend
from strandline.surrogate.field.restricted_evidence import Conditioned, Observed, condition_mode, restricted_evidence

__all__ = ["LeftOut", "ModeProcess", "fit_mode"]

LENGTHS = (0.2, 40.0)
"""Bounds of the length scales, in standard deviations of the inputs over the box."""
NUGGETS = (1e-10, 1e-2)
"""Bounds of the noise variance, relative to that of the process."""
TYPICAL_LENGTH, LENGTH_SPREAD = 3.0, 1.5
"""Median and spread, in logarithms, of the prior of a length scale: it decides if too few runs do."""
STARTS = (3.0, 1.0)
SHORT_START, NOISY = 0.3, 1e-3
"""A last start, made if the others ended with at least this nugget: they may have taken a fast response for scatter."""
_STARTING_NUGGET = 1e-6
_ITERATIONS = 40
_LARGE = 120  # observations from which a single start is made
_QUICK_ITERATIONS = 15
_PRIOR_RUNS = 4.0  # weight of "the variances are right" against the residuals


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Each run predicted from all others: error of the value, and its variance by the process (run,)."""

    errors: Float[np.ndarray, " run"]
    variances: Float[np.ndarray, " run"]


@dataclass(frozen=True, eq=False)
class ModeProcess:
    """The process of one coefficient; inputs of all methods are standardised.

    Args:
        observed: Data that it was conditioned on.
        lengths: Length scales, in standard deviations of the inputs.
        nugget: Noise variance relative to that of the process.
        factors: Factors of its covariance.
        widening: Factor of all variances, at least 1, by which the errors of left-out runs exceed what they should be.
    """

    observed: Observed
    lengths: Float[np.ndarray, " dim"]
    nugget: float
    factors: Conditioned
    widening: float = 1.0

    def mean(self, z: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, " point"]:
        """Return the posterior mean.

        The derivatives' part is k (u - v)·β, so matrix products do everything but the exponential.
        """
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

    def variance(self, z: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, " point"]:
        """Return the posterior variance of the coefficient, including the uncertainty of its mean function."""
        half, of_mean = self._reduced(z)
        explained = np.einsum("rp,rp->p", half, half) - np.einsum("tp,tp->p", of_mean, of_mean)
        return np.asarray(self.scale * np.maximum(1.0 - explained, 0.0))

    def covariance(
        self, z: Float[np.ndarray, "point dim"], other: Float[np.ndarray, "other dim"]
    ) -> Float[np.ndarray, "point other"]:
        """Return the posterior covariance of the coefficient at two sets of inputs."""
        (a, a_mean), (b, b_mean) = self._reduced(z), self._reduced(other)
        prior = covariance(z / self.lengths, other / self.lengths, rows=False, columns=False)
        return np.asarray(self.scale * (prior - a.T @ b + a_mean.T @ b_mean))

    @property
    def scale(self) -> float:
        """Variance of the process before any run."""
        return self.factors.variance * self.widening

    def left_out(self) -> LeftOut:
        """Return the errors of leave-one-run-out prediction; its gradient is left out with its value.

        Closed form with the precision matrix: Rasmussen and Williams (2006), Section 5.4.2, in blocks.
        """
        n, P = len(self.observed.z), self.factors.precision
        rows = np.arange(len(P)).reshape(-1, n).T
        blocks = np.linalg.inv(P[rows[:, :, None], rows[:, None, :]])
        errors = np.einsum("nk,nk->n", blocks[:, 0], self.factors.alpha[rows])
        return LeftOut(errors, self.scale * blocks[:, 0, 0])

    def _rows(self, z: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, "point row"]:
        gradients = self.observed.gradients is not None
        return covariance(z / self.lengths, self.observed.z / self.lengths, rows=False, columns=gradients)

    def _trend(self, z: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, "point term"]:
        return trend(z, self.lengths, linear=self.observed.linear, derivatives=False)

    def _reduced(
        self, z: Float[np.ndarray, "point dim"]
    ) -> tuple[Float[np.ndarray, "row point"], Float[np.ndarray, "term point"]]:
        """Return roots of the variance at z that the runs explain and of the part that the unknown mean adds."""
        rows = self._rows(z)
        half = solve_triangular(self.factors.cholesky, rows.T, lower=True, check_finite=False)
        unexplained = self._trend(z) - rows @ self.factors.solved_trend
        root = np.linalg.cholesky(self.factors.normal)
        return half, np.asarray(solve_triangular(root, unexplained.T, lower=True, check_finite=False))


def fit_mode(observed: Observed, *, quick: bool = False) -> ModeProcess:
    """Return the process whose length scales and nugget maximise the restricted evidence and their weak prior.

    With `quick`, there are one start and few iterations, for comparisons.

    Raises:
        NumericsError: No start of the optimiser led to hyperparameters with a covariance that can be factorised.
    """
    dim = observed.z.shape[1]
    box = [tuple(map(math.log, LENGTHS))] * dim + [tuple(map(math.log, NUGGETS))]
    rows = len(observed.z) * (1 if observed.gradients is None else 1 + dim)
    best, noisy = None, math.log(NOISY)
    for start in (*STARTS[: 1 if quick or rows > _LARGE else None], SHORT_START):
        if start == SHORT_START and best is not None and best.x[dim] < noisy:
            break
        at = np.array([math.log(start)] * dim + [math.log(_STARTING_NUGGET)])
        limit = {"maxiter": _QUICK_ITERATIONS if quick else _ITERATIONS}
        found = minimize(_objective, at, args=(observed,), jac=True, method="L-BFGS-B", bounds=box, options=limit)
        if found.fun < _WALL and (best is None or found.fun < best.fun):
            best = found
    if best is None:
        raise NumericsError("no length scales were found for a mode of the field: do repeated runs differ?")
    lengths, nugget = np.exp(best.x[:dim]), float(np.exp(best.x[dim]))
    process = ModeProcess(observed, lengths, nugget, condition_mode(observed, lengths, nugget))
    left_out = process.left_out()
    surprise = float(np.sum(left_out.errors**2 / np.maximum(left_out.variances, 1e-300)))
    return replace(process, widening=max(1.0, (surprise + _PRIOR_RUNS) / (len(observed.z) + _PRIOR_RUNS)))


_WALL = 1e25


def _objective(
    at: Float[np.ndarray, " coordinate"], observed: Observed
) -> tuple[float, Float[np.ndarray, " coordinate"]]:
    """Return minus the log evidence and minus the log prior of the lengths; a wall if there is no evidence."""
    dim = len(at) - 1
    try:
        value, slope = restricted_evidence(observed, at[:dim], float(at[dim]))
    except NumericsError:
        return 2 * _WALL, np.zeros(len(at))
    off = (at[:dim] - math.log(TYPICAL_LENGTH)) / LENGTH_SPREAD
    prior = np.append(off / LENGTH_SPREAD, 0.0)
    return -value + 0.5 * float(off @ off), prior - slope
