"""strandline against other programs on the same task, side by side in one process.

Both do each task in turns, after one unmeasured call of each; the table shows medians of the repeats and their ratio
(above 1: strandline is faster). Both must give the same answer, or the benchmark stops. Times depend on the machine and
its load; ratios less so.
"""

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import jax
import numpy as np
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern
from verification.benchmarks.comparison import Comparison, compare_all, compared, summarised

from strandline import Currents, Interface, LocalProcesses
from strandline.runs import RunRequest
from strandline.surrogate import KERNELS, evidence
from strandline.testing.models import Cantilever

RUNS, INTERFACES, TRIVIAL_RUNS = 1000, 200, 300
LENGTH, VARIANCE, NUGGET = 1.3, 500.0, 5e-4
WIDTH = 0.005
PEER_NODES = 7


def main() -> list[dict[str, Any]]:
    """Print each comparison as it is made; return them all."""
    jax.config.update("jax_enable_x64", True)
    return compare_all(gp_fit, currents_centre, currents_refined, executor)


def gp_fit() -> Comparison:
    """Compare the evidence and its gradient by the hyperparameters of the published study's kernel."""
    x, y = training()
    standard, centred = (x - x.mean(0)) / x.std(0), y - y.mean()
    kernel = ConstantKernel(VARIANCE) * Matern(LENGTH, nu=1.5)
    peer = GaussianProcessRegressor(kernel, alpha=NUGGET, optimizer=None).fit(standard, centred)
    theta = peer.kernel_.theta

    def mine() -> float:
        return evidence(
            standard,
            centred,
            kernel=KERNELS["matern32"],
            length_scale=LENGTH,
            signal_variance=VARIANCE,
            nugget=NUGGET,
        ).value

    def theirs() -> float:
        return float(peer.log_marginal_likelihood(theta, eval_gradient=True, clone_kernel=False)[0])

    return compared(f"GP: evidence and gradient, n = {RUNS}", "scikit-learn", mine, theirs, rtol=1e-6)


def currents_centre() -> Comparison:
    """Compare d² of a campaign's interfaces by the centre rule."""
    observed, simulated = interfaces()
    measure = Currents(WIDTH, quadrature="centre")

    def mine() -> Any:
        return np.array([measure(one, observed) for one in simulated])

    def theirs() -> Any:
        return np.array([all_pairs(one, observed, nodes=1) for one in simulated])

    return compared(f"currents, centre rule, {INTERFACES} interfaces", "all pairs in NumPy", mine, theirs, rtol=1e-6)


def currents_refined() -> Comparison:
    """Compare d² by the refined quadrature; the peer has enough Gauss points per segment for 1e-6 of ⟨T,T⟩."""
    observed, simulated = interfaces()
    measure = Currents(WIDTH)
    scale = measure.inner(observed, observed)

    def mine() -> Any:
        return np.array([measure(one, observed) for one in simulated]) / scale

    def theirs() -> Any:
        return np.array([all_pairs(one, observed, nodes=PEER_NODES) for one in simulated]) / scale

    what = f"currents, refined quadrature, {INTERFACES} interfaces"
    return compared(what, f"{PEER_NODES} Gauss points a segment", mine, theirs, rtol=0.0, atol=1e-6, repeats=5)


def executor() -> Comparison:
    """Compare the time per run of a model that costs nothing, from the first record to the last."""
    inputs = [{"E": 1e4 + i, "load": 0.01} for i in range(TRIVIAL_RUNS)]

    def mine() -> Iterator[object]:
        requests = [RunRequest(str(i), one) for i, one in enumerate(inputs)]
        return LocalProcesses(workers=2)(Cantilever(), requests)

    def theirs() -> Iterator[object]:
        with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
            yield from as_completed([pool.submit(Cantilever(), one, Path()) for one in inputs])

    seconds = [(paced(mine), paced(theirs)) for _ in range(5)]
    return summarised(f"executor: overhead of a run, {TRIVIAL_RUNS} runs", "concurrent.futures", seconds)


def training() -> tuple[np.ndarray, np.ndarray]:
    """Return inputs and the values of a ridge that looks like a log-likelihood."""
    x = np.random.default_rng(0).random((RUNS, 2))
    return x, -30.0 * (x[:, 0] * (1 + x[:, 1] ** 2) - 0.6) ** 2


def interfaces() -> tuple[Interface, list[Interface]]:
    """Return an arch of 66 nodes, as large as the biofilm, and deformed ones."""
    t = np.linspace(0.0, np.pi, 66)
    rng = np.random.default_rng(2)
    arch = np.stack([1.0 - 0.43 * np.cos(t), 0.47 * np.sin(t)], axis=1)
    bends = 0.05 * rng.random((INTERFACES, 1)) * np.sin(t)
    moved = [arch + np.stack([bend, np.zeros_like(bend)], axis=1) for bend in bends]
    return Interface.polyline(arch), [Interface.polyline(points) for points in moved]


def all_pairs(a: Interface, b: Interface, *, nodes: int) -> float:
    """Return d² by a Gauss rule of `nodes` points on each segment and all pairs of points at once."""
    (x, n), (y, m) = (gauss_points(one, nodes) for one in (a, b))

    def inner(x: np.ndarray, n: np.ndarray, y: np.ndarray, m: np.ndarray) -> float:
        r2 = ((x[:, None, :] - y[None, :, :]) ** 2).sum(axis=2)
        return float((np.exp(-0.5 * r2 / WIDTH**2) * (n @ m.T)).sum())

    return inner(x, n, x, n) - 2 * inner(x, n, y, m) + inner(y, m, y, m)


def gauss_points(one: Interface, nodes: int) -> tuple[np.ndarray, np.ndarray]:
    place, weight = np.polynomial.legendre.leggauss(nodes)
    share = 0.5 * (place + 1)
    points = one.starts[:, None] + share[:, None] * (one.ends - one.starts)[:, None]
    normals = 0.5 * weight[:, None] * one.normals[:, None]
    return points.reshape(-1, 2), normals.reshape(-1, 2)


def paced(task: Callable[[], Iterator[object]]) -> float:
    """Return the mean seconds between the items that `task` yields."""
    records = task()
    next(records)
    begun = time.perf_counter()
    number = sum(1 for _ in records)
    return (time.perf_counter() - begun) / number
