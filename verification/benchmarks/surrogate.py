"""The fit of the surrogate compared with its lower bound and with other programs: evidence and gradient, seven inputs.

The lower bound is the time that LAPACK takes for the Cholesky factor and the inverse of the given covariance. All get
the same hyperparameters and must give the same evidence, or the benchmark stops. OMP_NUM_THREADS limits LAPACK, the
passes over the matrix and scikit-learn alike. JAX, GPJax, GPyTorch and strandline each run in their own process, all on
the same number of cores.
"""

import os
import sys
from collections.abc import Callable, Iterator
from functools import reduce
from operator import mul
from pathlib import Path
from typing import Any

import jax
import numpy as np
from scipy.linalg import lapack
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern
from verification.benchmarks.figures import Figure, NotMeasured, compared
from verification.benchmarks.workers import PEERS_PYTHON, cores_case, versus

from strandline.design import sobol
from strandline.surrogate import KERNELS
from strandline.surrogate.hyperparameters import Objective

LENGTHS, VARIANCE, NUGGET = np.array([1.3, 2.5, 3.1, 4.0, 6.0, 8.0, 10.0]), 500.0, 5e-3
USUAL, LARGE, REPEATS = 2000, 5000, 5
PEERS = (
    ("JAX, autodiff of a Cholesky", "jax", Path(sys.executable)),
    ("GPJax", "gpjax", PEERS_PYTHON),
    ("GPyTorch", "gpytorch", PEERS_PYTHON),
)
"""Name, program of ``peers/evidence.py``, and Python."""


def figures() -> Iterator[Figure]:
    """Yield the figures of the fit."""
    jax.config.update("jax_enable_x64", True)
    for name in ("matern32", "matern32_ard", "matern32_product", "matern52_product"):
        yield floor(name, USUAL)
    yield floor("matern32_product", LARGE)
    yield scikit_learn("matern32_ard", USUAL)
    yield scikit_learn("matern32_product", USUAL)
    yield from (in_processes(*peer, cores=cores) for cores in sorted({1, os.cpu_count() or 1}) for peer in PEERS)


def floor(name: str, runs: int) -> Figure:
    """Compare with Cholesky factor and inverse alone; the aim for 5000 runs is a ratio of 1 / 1.4."""
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

    return compared(_what(name, runs), "dpotrf + dpotri alone", ours(name, x, y), theirs, rtol=1e-6, repeats=REPEATS)


def scikit_learn(name: str, runs: int) -> Figure:
    """Compare with scikit-learn, which takes each factor of the product as a kernel of one column."""
    x, y = training(runs)
    kernel = ConstantKernel(VARIANCE) * Matern(LENGTHS, nu=1.5) if name == "matern32_ard" else product()
    theirs = marginal(x, y, kernel, NUGGET)
    return compared(_what(name, runs), "scikit-learn", ours(name, x, y), theirs, rtol=1e-6, repeats=REPEATS)


def marginal(x: np.ndarray, y: np.ndarray, kernel: Any, nugget: float) -> Callable[[], float]:
    """Return scikit-learn's log marginal likelihood, which computes its gradient too."""
    peer = GaussianProcessRegressor(kernel, alpha=nugget, optimizer=None).fit(x, y)
    theta = peer.kernel_.theta
    return lambda: float(peer.log_marginal_likelihood(theta, eval_gradient=True, clone_kernel=False)[0])


def product() -> Any:
    """Return scikit-learn's product of a kernel for each input."""
    return ConstantKernel(VARIANCE) * reduce(mul, [Column(one, nu=1.5, column=d) for d, one in enumerate(LENGTHS)])


def in_processes(peer_name: str, program: str, python: Path, *, cores: int, runs: int = USUAL) -> Figure:
    """Compare with a peer in its own process and environment; gradients must agree as well."""
    x, y = training(runs)
    content = {"x": x, "y": y, "lengths": LENGTHS, "variance": VARIANCE, "nugget": NUGGET}
    programs, task = (["evidence.py", "strandline"], ["evidence.py", program]), _what("matern32_product", runs)
    try:
        return versus(task, peer_name, programs, content, cores=cores, python=python, repeats=REPEATS)
    except NotMeasured as why:
        return Figure(task, cores_case(cores), peer_name=peer_name, remark=str(why))


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
    """Return an evaluation as a fit makes it dozens of times, on arrays that it keeps."""
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


def _what(name: str, runs: int) -> str:
    return f"evidence and gradient, {name}, n = {runs}"
