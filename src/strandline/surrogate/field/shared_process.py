"""Gaussian processes of the modes of a field for many inputs: one kernel for all modes, values with all derivatives or
none.

The covariance of two runs is exp(w · w'), with w the inputs from a centre amid the runs, weighed by how much they move
the interface: w = Rᵀ (z - c) S, where R are eigenvectors of the mean of JᵀJ over the runs, J the derivatives, and S² a
power of their eigenvalues times a factor. Power and factor have the largest evidence. A function of this process is
linear in inputs that hardly move the interface, and its slope there depends on the others. Without derivatives, J is
first that of a linear fit, then what the process predicts.

Derivatives along directions that are orthogonal to all runs' w are independent of the values and of all derivatives
along the runs' w, so the matrix to factorise has only as many rows for each run as there are runs, however many inputs
(de Roos, Gessner and Hennig, High-dimensional Gaussian process inference with derivatives, 2021, use this too).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import cho_factor, cho_solve, lapack, solve_triangular

from strandline.foundations import NumericsError
from strandline.surrogate.field.mode_process import LeftOutErrors, ModeData

FACTORS, FIRST, POWERS = (0.2, 0.3, 0.45, 0.7, 1.0, 1.4, 2.0, 2.8), 4, (0.25, 0.5)
"""Factors of the eigenvalues' powers, which of them is tried first, and these powers."""
CHOOSING = 40  # runs that choose them: with all of 100 runs, a batch of 100 inputs took 3 minutes
LEAST = 1e-6  # least weight of an input, relative to the largest
NUGGET = 1e-8
ROUNDS = 2  # times that slopes are predicted from values alone, where there are no others, to weigh the inputs
_PRIOR_RUNS = 4.0  # weight of "the variances are right" against the residuals

Points = Float[np.ndarray, "point dim"]


@dataclass(frozen=True, eq=False)
class SharedKernel:
    """The kernel and its factors at the runs: `weighing` maps z - centre to w, `span` is a basis of the runs' w."""

    centre: Float[np.ndarray, " dim"]
    weighing: Float[np.ndarray, "dim dim"]
    w: Float[np.ndarray, "run dim"]
    span: Float[np.ndarray, "dim span"]
    of_span: Float[np.ndarray, "row row"]
    of_rest: Float[np.ndarray, "run run"]

    def weighed(self, z: Points) -> Points:
        return np.asarray((z - self.centre) @ self.weighing)

    def unexplained(self, z: Points) -> Float[np.ndarray, " point"]:
        """Return the variance that the runs leave, over that at the centre before any run: the same for all modes."""
        w = self.weighed(z)
        rest, half, other = self.reduced(w)
        explained = np.einsum("rp,rp->p", half, half) + (rest**2).sum(axis=1) * np.einsum("rp,rp->p", other, other)
        return np.asarray(np.maximum(np.exp((w**2).sum(axis=1)) - explained, 0.0))

    @cached_property
    def left_out(self) -> tuple[Int[np.ndarray, "run part"], Float[np.ndarray, "run part"]]:
        """Return the rows of each run, and the covariances of its value with these, given all other runs."""
        n, q = len(self.w), self.span.shape[1]
        P, _ = lapack.dpotri(self.of_span, lower=1)
        rows = np.concatenate([np.arange(n)[:, None], n + np.arange(n * q).reshape(n, q)], axis=1)
        blocks = np.tril(P[rows[:, :, None], rows[:, None, :]])
        blocks += np.tril(blocks, -1).swapaxes(1, 2)
        return rows, np.linalg.inv(blocks)[:, 0]

    def reduced(self, w: Points) -> tuple[Points, Float[np.ndarray, "row point"], Float[np.ndarray, "run point"]]:
        """Return what of w is outside the span, and the roots of what the runs explain, along the span and outside."""
        k, along = np.exp(w @ self.w.T), w @ self.span
        rows = np.concatenate([k[:, :, None], k[:, :, None] * along[:, None, :]], axis=2)
        half = solve_triangular(self.of_span, _value_first(rows).T, lower=True, check_finite=False)
        if not self.span.shape[1]:
            return 0.0 * w, half, half  # there are no derivatives
        return w - along @ self.span.T, half, solve_triangular(self.of_rest, k.T, lower=True, check_finite=False)


def _value_first(rows: Float[np.ndarray, "some run part"]) -> Float[np.ndarray, "some row"]:
    """Return values of all runs, then the derivatives run by run."""
    return np.concatenate([rows[:, :, 0], rows[:, :, 1:].reshape(len(rows), -1)], axis=1)


@dataclass(frozen=True, eq=False)
class SharedProcess:
    """The process of one coefficient; inputs of all methods are standardised. See `ModeProcess`."""

    observed: ModeData
    kernel: SharedKernel
    offset: float
    by_value: Float[np.ndarray, " run"]
    by_slope: Float[np.ndarray, "run dim"]
    alpha: Float[np.ndarray, " row"]
    size: float
    widening: float = 1.0
    nugget: float = NUGGET

    def mean(self, z: Points) -> Float[np.ndarray, " point"]:
        w = self.kernel.weighed(z)
        k = np.exp(w @ self.kernel.w.T)
        return np.asarray(self.offset + np.einsum("pr,pr->p", k, self.by_value + w @ self.by_slope.T))

    def variance(self, z: Points) -> Float[np.ndarray, " point"]:
        return np.asarray(self.scale * self.kernel.unexplained(z))

    def covariance(self, z: Points, other: Float[np.ndarray, "other dim"]) -> Float[np.ndarray, "point other"]:
        u, v = self.kernel.weighed(z), self.kernel.weighed(other)
        (a_rest, a, a_other), (b_rest, b, b_other) = self.kernel.reduced(u), self.kernel.reduced(v)
        explained = a.T @ b + (a_rest @ b_rest.T) * (a_other.T @ b_other)
        return np.asarray(self.scale * (np.exp(u @ v.T) - explained))

    @property
    def scale(self) -> float:
        """Variance of the process at the centre before any run."""
        return self.size * self.widening

    def left_out(self) -> LeftOutErrors:
        """Return the errors of leave-one-run-out prediction, see `ModeProcess`: derivatives outside the span tell
        nothing of the values at runs.
        """
        rows, values = self.kernel.left_out
        return LeftOutErrors(np.einsum("nk,nk->n", values, self.alpha[rows]), self.scale * values[:, 0])


def mean_with_slopes(
    processes: Sequence[SharedProcess], z: Points
) -> tuple[Float[np.ndarray, "point mode"], Callable[[Float[np.ndarray, "point mode"]], Points]]:
    """Return the means of all modes, and a function of factors of the modes → the derivative of their sum by z."""
    kernel = processes[0].kernel
    w = kernel.weighed(z)
    k = np.exp(w @ kernel.w.T)
    values, slopes = (np.stack(one) for one in zip(*((p.by_value, p.by_slope) for p in processes), strict=True))
    runs = values[:, None] + np.einsum("pd,mrd->mpr", w, slopes, optimize=True)
    offsets = np.array([one.offset for one in processes])

    def by_inputs(factors: Float[np.ndarray, "point mode"]) -> Points:
        weighed = np.einsum("pm,mpr->pr", factors, runs)
        along = (factors[:, :, None] * k[:, None, :]).reshape(len(z), -1) @ slopes.reshape(-1, w.shape[1])
        return np.asarray(((k * weighed) @ kernel.w + along) @ kernel.weighing.T)

    return offsets + np.einsum("pr,mpr->pm", k, runs), by_inputs


def fit_shared(observed: Sequence[ModeData]) -> tuple[SharedProcess, ...]:
    """Return a process of each mode, from values and derivatives at the same runs.

    Raises:
        NumericsError: No kernel has a covariance that can be factorised.
    """
    z, slopes = observed[0].z, None
    if all(one.gradients is not None for one in observed):
        slopes = np.stack([one.gradients for one in observed if one.gradients is not None], axis=1)
    values = np.stack([one.values for one in observed], axis=1)
    centre = np.median(z, axis=0)
    nearest = int(np.argmin(((z - centre) ** 2).sum(axis=1)))
    away, changes = z - centre, values - values[nearest]
    guess = slopes
    if slopes is None:
        guess = np.linalg.lstsq(z - z[nearest], changes, rcond=None)[0].T[None]
        for _ in range(ROUNDS):
            _, (weighing, w, *_), alpha, *_ = _likeliest(away, changes, None, guess)
            guess = np.einsum("pr,rm,rd->pmd", np.exp(w @ w.T), alpha, w, optimize=True) @ weighing.T
    best = _likeliest(away, changes, slopes, guess)
    _, (weighing, w, span, *factors), alpha, by_value, by_slope, size = best
    kernel = SharedKernel(centre, weighing, w, span, *(np.tril(one) for one in factors))
    found = []
    for m, one in enumerate(observed):
        process = SharedProcess(
            one, kernel, values[nearest, m], by_value[:, m], by_slope[:, :, m], alpha[:, m], size[m]
        )
        told = process.left_out()
        surprise = float(np.sum(told.errors**2 / np.maximum(told.variances, 1e-300)))
        widening = max(1.0, (surprise + _PRIOR_RUNS) / (len(z) + _PRIOR_RUNS))
        found.append(replace(process, widening=widening))
    return tuple(found)


def _likeliest(z: Any, values: Any, slopes: Any, told: Any) -> tuple[Any, ...]:
    """Return what `_fitted` does of the kernel with the largest evidence, which has one maximum over the factors.

    Derivatives that are `told` (run, mode, dim) weigh the inputs. Of more runs with derivatives than `CHOOSING`, as
    many choose the kernel.
    """
    few: Any = slice(None)
    if slopes is not None and len(z) > CHOOSING:
        few = np.linspace(0, len(z) - 1, CHOOSING).astype(int)
    eigenvalues, R = np.linalg.eigh(np.einsum("rmi,rmj->ij", told, told) / len(told))
    shares = np.maximum(eigenvalues / eigenvalues[-1], 0.0)
    best: tuple[Any, ...] | None = None
    weighing = R
    for power in POWERS:
        tried: dict[int, float] = {}
        now, last = FIRST, None
        while now != last:
            last, near = now, [k for k in (now, now + 1, now - 1) if 0 <= k < len(FACTORS)]
            for k in (k for k in near if k not in tried):
                by = R * FACTORS[k] * np.sqrt(np.maximum(shares**power, LEAST))
                one = _fitted(z[few], values[few], None if slopes is None else slopes[few], by)
                tried[k] = -np.inf if one is None else one[0]
                if one is not None and (best is None or one[0] > best[0]):
                    best, weighing = one, by
            now = max(near, key=tried.__getitem__)
    if best is not None and slopes is not None and len(z) > CHOOSING:
        best = _fitted(z, values, slopes, weighing)
    if best is None:
        raise NumericsError("no kernel was found for the modes of the field: do repeated runs differ?")
    return best


def _fitted(z: Any, values: Any, slopes: Any, weighing: Any) -> tuple[Any, ...] | None:
    """Return the log evidence, the parts of a `SharedKernel`, and the weights of values and derivatives."""
    (n, dim), modes = z.shape, values.shape[1]
    w = z @ weighing
    if slopes is None:
        return _by_values(w, values, weighing)
    by_w = np.linalg.solve(weighing, slopes.reshape(-1, dim).T).T.reshape(n, modes, dim)
    U, sizes, _ = np.linalg.svd(w.T, full_matrices=False)
    Q = U[:, sizes > 1e-9 * sizes[0]]
    along, q = w @ Q, Q.shape[1]
    E = np.exp(w @ w.T)
    by_value = E[:, :, None] * along[:, None, :]
    K = np.empty((n * (q + 1), n * (q + 1)))
    K[:n, :n], K[:n, n:] = E, by_value.reshape(n, n * q)
    K[n:, :n] = K[:n, n:].T
    blocks = E[:, :, None, None] * np.einsum("ja,ib->ijab", along, along)
    blocks[..., np.arange(q), np.arange(q)] += E[:, :, None]
    K[n:, n:] = blocks.transpose(0, 2, 1, 3).reshape(n * q, n * q)
    K[np.diag_indices_from(K)] += NUGGET
    try:
        L, _ = cho_factor(K, lower=True, overwrite_a=True, check_finite=False)
        L_rest, _ = cho_factor(E + NUGGET * np.eye(n), lower=True)
    except (np.linalg.LinAlgError, ValueError):
        return None
    by_span = by_w @ Q
    rest = (by_w - by_span @ Q.T).reshape(n, modes * dim)
    right = np.concatenate([values, by_span.transpose(0, 2, 1).reshape(n * q, modes)])
    alpha, beta = cho_solve((L, True), right, check_finite=False), cho_solve((L_rest, True), rest)
    rows = n * (1 + dim)
    squares = (right * alpha).sum(axis=0) + (rest * beta).reshape(n, modes, dim).sum(axis=(0, 2))
    size = np.maximum(squares / rows, 1e-300)
    logs = [float(np.log(np.diagonal(one)).sum()) for one in (L, L_rest)]
    weights = n * float(np.linalg.slogdet(weighing)[1])
    evidence = -0.5 * rows * float(np.log(size).sum()) - modes * (logs[0] + (dim - q) * logs[1] + weights)
    by_slope = np.einsum("nqm,dq->ndm", alpha[n:].reshape(n, q, modes), Q) + beta.reshape(n, modes, dim).swapaxes(1, 2)
    return evidence, (weighing, w, Q, L, L_rest), alpha, alpha[:n], by_slope, size


def _by_values(w: Any, values: Any, weighing: Any) -> tuple[Any, ...] | None:
    """Return what `_fitted` does, without derivatives."""
    n, dim = w.shape
    K = np.exp(w @ w.T) + NUGGET * np.eye(n)
    try:
        L, _ = cho_factor(K, lower=True, check_finite=False)
    except (np.linalg.LinAlgError, ValueError):
        return None
    alpha = cho_solve((L, True), values, check_finite=False)
    size = np.maximum((values * alpha).sum(axis=0) / n, 1e-300)
    evidence = -0.5 * n * float(np.log(size).sum()) - values.shape[1] * float(np.log(np.diagonal(L)).sum())
    none = np.zeros((dim, 0))
    return evidence, (weighing, w, none, L, L), alpha, alpha, np.zeros((n, dim, values.shape[1])), size
