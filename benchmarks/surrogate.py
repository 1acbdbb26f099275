"""The fit of the surrogate beside its own floor and beside other programs: evidence and gradient, seven inputs.

The floor is what LAPACK takes for the Cholesky factor and the inverse of the same covariance, once that is there. All
get the same hyperparameters and give the same evidence, or the benchmark stops. OMP_NUM_THREADS limits LAPACK and the
passes over the matrix alike; XLA has threads of its own.
"""

from collections.abc import Callable
from dataclasses import asdict
from functools import reduce
from operator import mul
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from benchmarks.comparison import Comparison, compared
from scipy.linalg import lapack
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern

from strandline.design import sobol
from strandline.surrogate import KERNELS
from strandline.surrogate.hyperparameters import Objective

LENGTHS, VARIANCE, NUGGET = np.array([1.3, 2.5, 3.1, 4.0, 6.0, 8.0, 10.0]), 500.0, 5e-3
USUAL, LARGE, REPEATS = 2000, 5000, 5


def main() -> list[dict[str, Any]]:
    """Print each comparison as it is made; return them all."""
    jax.config.update("jax_enable_x64", True)
    print(f"{'task':<52} {'peer':<30} {'ours [ms]':>10} {'peer [ms]':>10} {'ratio':>7}")
    found = []
    for task, name, runs in (
        (floor, "matern32", USUAL),
        (floor, "matern32_ard", USUAL),
        (floor, "matern32_product", USUAL),
        (floor, "matern52_product", USUAL),
        (floor, "matern32_product", LARGE),
        (scikit_learn, "matern32_ard", USUAL),
        (scikit_learn, "matern32_product", USUAL),
        (automatic, "matern32_product", USUAL),
    ):
        result = task(name, runs)
        found.append(asdict(result))
        print(
            f"{result.what:<52} {result.peer_name:<30} {1e3 * result.ours:>10.4g} {1e3 * result.peer:>10.4g}"
            f" {result.ratio:>7.2f}",
            flush=True,
        )
    return found


def floor(name: str, runs: int) -> Comparison:
    """Return the comparison with Cholesky factor and inverse alone; a ratio of 1 / 1.4 is the aim for 5000 runs."""
    x, y = training(runs)
    u = x / (LENGTHS if KERNELS[name].per_input else LENGTHS[0])
    K = np.empty((runs, runs), order="F")
    for j, point in enumerate(u):
        K[:, j] = VARIANCE * KERNELS[name].value(u - point)
    K[np.diag_indices(runs)] += NUGGET
    work = np.empty_like(K)

    def theirs() -> float:
        np.copyto(work, K)
        lapack.dpotrf(work, lower=1, clean=0, overwrite_a=1)
        value = gaussian(y, lapack.dpotrs(work, y, lower=1)[0], np.diagonal(work))
        lapack.dpotri(work, lower=1, overwrite_c=1)
        return value

    return compared(what(name, runs), "dpotrf + dpotri alone", ours(name, x, y), theirs, rtol=1e-6, repeats=REPEATS)


def scikit_learn(name: str, runs: int) -> Comparison:
    """Return the comparison with scikit-learn, to which a factor of the product is a kernel of one column."""
    x, y = training(runs)
    correlation = (
        Matern(LENGTHS, nu=1.5)
        if name == "matern32_ard"
        else reduce(mul, [Column(length, nu=1.5, column=d) for d, length in enumerate(LENGTHS)])
    )
    peer = GaussianProcessRegressor(ConstantKernel(VARIANCE) * correlation, alpha=NUGGET, optimizer=None).fit(x, y)
    theta = peer.kernel_.theta

    def theirs() -> float:
        return float(peer.log_marginal_likelihood(theta, eval_gradient=True, clone_kernel=False)[0])

    return compared(what(name, runs), "scikit-learn", ours(name, x, y), theirs, rtol=1e-6, repeats=REPEATS)


def automatic(name: str, runs: int) -> Comparison:
    """Return the comparison with the same evidence written in JAX and differentiated by JAX."""
    x, y = training(runs)
    correlation = KERNELS[name].of_columns

    @jax.jit
    @jax.value_and_grad
    def negative(theta: jax.Array) -> jax.Array:
        u = (x / jnp.exp(theta[1:])).T
        K = jnp.exp(theta[0]) * correlation(list(u[:, :, None] - u[:, None, :])) + NUGGET * jnp.eye(runs)
        L = jnp.linalg.cholesky(K)
        alpha = jax.scipy.linalg.cho_solve((L, True), y)
        return 0.5 * y @ alpha + jnp.log(jnp.diagonal(L)).sum() + 0.5 * runs * jnp.log(2 * jnp.pi)

    theta = jnp.log(jnp.array([VARIANCE, *LENGTHS]))

    def theirs() -> float:
        value, slope = negative(theta)
        jax.block_until_ready(slope)
        return -float(value)

    return compared(
        what(name, runs), "JAX, autodiff of a Cholesky", ours(name, x, y), theirs, rtol=1e-6, repeats=REPEATS
    )


class Column(Matern):
    """scikit-learn's Matérn kernel of one input."""

    def __init__(
        self,
        length_scale: float = 1.0,
        length_scale_bounds: tuple[float, float] = (1e-5, 1e5),
        nu: float = 1.5,
        column: int = 0,
    ) -> None:
        super().__init__(length_scale, length_scale_bounds, nu)
        self.column = column

    def __call__(self, X: np.ndarray, Y: np.ndarray | None = None, eval_gradient: bool = False) -> Any:
        chosen = [self.column]
        return super().__call__(X[:, chosen], None if Y is None else Y[:, chosen], eval_gradient)


def ours(name: str, x: np.ndarray, y: np.ndarray) -> Callable[[], float]:
    """Return an evaluation as a fit makes it, dozens of times on arrays that it keeps."""
    log_lengths = np.log(LENGTHS if KERNELS[name].per_input else LENGTHS[:1])
    objective, log_ratio = Objective(x, y, KERNELS[name], NUGGET), np.log(VARIANCE) - 3 * log_lengths.mean()
    return lambda: objective.evidence(float(log_ratio), log_lengths.tolist()).value


def gaussian(y: np.ndarray, alpha: np.ndarray, diagonal: np.ndarray) -> float:
    """Return the log density of y, given K⁻¹ y and the diagonal of K's Cholesky factor."""
    return float(-0.5 * y @ alpha - np.log(diagonal).sum() - 0.5 * len(y) * np.log(2 * np.pi))


def training(runs: int) -> tuple[np.ndarray, np.ndarray]:
    """Return standardised inputs and a centred function that looks like a log-likelihood."""
    u = sobol(runs, 7)
    y = -40 * (u[:, 0] - 0.3 - 0.3 * u[:, 1] ** 2) ** 2 - 10 * (u[:, 2] * u[:, 3] - 0.2) ** 2
    y = y - 0.5 * u[:, 4] - 0.1 * u[:, 5] - np.sin(3 * u[:, 6])
    return (u - u.mean(0)) / u.std(0), y - y.mean()


def what(name: str, runs: int) -> str:
    return f"evidence and gradient, {name}, n = {runs}"
