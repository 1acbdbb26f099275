"""strandline against other programs on the same task, side by side in one process.

Both do each task in turns, after one unmeasured call of each; the table shows medians of the repeats and their ratio
(above 1: strandline is faster). Both must give the same answer, or the benchmark stops. Times depend on the machine and
its load; ratios less so.
"""

import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

import jax
import numpy as np
from sklearn.gaussian_process.kernels import ConstantKernel, Matern
from verification.benchmarks.executors import overhead
from verification.benchmarks.figures import Figure, compared, in_turns
from verification.benchmarks.norms import arches
from verification.benchmarks.surrogate import marginal

from strandline import Currents, Interface, LocalProcesses
from strandline.surrogate import KERNELS, evidence
from strandline.testing.models import Cantilever

RUNS, INTERFACES, TRIVIAL_RUNS = 1000, 200, 300
LENGTH, VARIANCE, NUGGET = 1.3, 500.0, 5e-4
WIDTH = 0.005
PEER_NODES = 7


def figures() -> Iterator[Figure]:
    """Yield the figures of small pieces of a study."""
    jax.config.update("jax_enable_x64", True)
    yield gp_fit()
    yield currents("centre", f"currents, centre rule, {INTERFACES} interfaces", "all pairs in NumPy", 1, 7)
    what = f"currents, refined quadrature, {INTERFACES} interfaces"
    yield currents("refined", what, f"{PEER_NODES} Gauss points a segment", PEER_NODES, 5)
    yield executor()


def gp_fit() -> Figure:
    """Compare the evidence and its gradient by the hyperparameters of the published study's kernel."""
    x, y = training()
    standard, centred = (x - x.mean(0)) / x.std(0), y - y.mean()
    kernel = ConstantKernel(VARIANCE) * Matern(LENGTH, nu=1.5)
    theirs = marginal(standard, centred, kernel, NUGGET)

    def mine() -> float:
        settings = {"length_scale": LENGTH, "signal_variance": VARIANCE, "nugget": NUGGET}
        return evidence(standard, centred, kernel=KERNELS["matern32"], **settings).value

    return compared(f"GP: evidence and gradient, n = {RUNS}", "scikit-learn", mine, theirs, rtol=1e-6)


def currents(quadrature: str, what: str, peer_name: str, nodes: int, repeats: int) -> Figure:
    """Compare d² of a campaign's interfaces, of the order of ⟨T,T⟩; the peer has Gauss points on each segment.

    Those of the refined quadrature are enough for 1e-6 of ⟨T,T⟩.
    """
    observed, shapes = arches(66, INTERFACES)
    simulated = [Interface.polyline(points) for points in shapes]
    measure = Currents(WIDTH, quadrature=quadrature)
    scale = measure.inner(observed, observed) if quadrature == "refined" else 1.0
    tolerance = {"rtol": 0.0, "atol": 1e-6} if quadrature == "refined" else {"rtol": 1e-6}

    def mine() -> np.ndarray:
        return np.array([measure(one, observed) for one in simulated]) / scale

    def theirs() -> np.ndarray:
        return np.array([all_pairs(one, observed, nodes=nodes) for one in simulated]) / scale

    return compared(what, peer_name, mine, theirs, repeats=repeats, **tolerance)


def executor() -> Figure:
    """Compare the time per run of a model that costs nothing, from the first record to the last."""
    seconds = [(overhead(LocalProcesses(workers=2), TRIVIAL_RUNS)[0], pool_overhead()) for _ in range(5)]
    return in_turns(f"executor: overhead of a run, {TRIVIAL_RUNS} runs", "concurrent.futures", seconds)


def training() -> tuple[np.ndarray, np.ndarray]:
    """Return inputs and the values of a ridge that looks like a log-likelihood."""
    x = np.random.default_rng(0).random((RUNS, 2))
    return x, -30.0 * (x[:, 0] * (1 + x[:, 1] ** 2) - 0.6) ** 2


def all_pairs(a: Interface, b: Interface, *, nodes: int) -> float:
    """Return d² by a Gauss rule of `nodes` points on each segment and all pairs of points at once."""
    (x, n), (y, m) = (_gauss_points(one, nodes) for one in (a, b))

    def inner(x: np.ndarray, n: np.ndarray, y: np.ndarray, m: np.ndarray) -> float:
        r2 = ((x[:, None, :] - y[None, :, :]) ** 2).sum(axis=2)
        return float((np.exp(-0.5 * r2 / WIDTH**2) * (n @ m.T)).sum())

    return inner(x, n, x, n) - 2 * inner(x, n, y, m) + inner(y, m, y, m)


def _gauss_points(one: Interface, nodes: int) -> tuple[np.ndarray, np.ndarray]:
    place, weight = np.polynomial.legendre.leggauss(nodes)
    share = 0.5 * (place + 1)
    points = one.starts[:, None] + share[:, None] * (one.ends - one.starts)[:, None]
    normals = 0.5 * weight[:, None] * one.normals[:, None]
    return points.reshape(-1, 2), normals.reshape(-1, 2)


def pool_overhead() -> float:
    """Return the mean seconds between results of a process pool."""
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        inputs = ({"E": 300.0 + 0.1 * i, "load": 1e-5} for i in range(TRIVIAL_RUNS))
        done = as_completed([pool.submit(Cantilever(), one, Path()) for one in inputs])
        next(done)
        begun = time.perf_counter()
        number = sum(1 for _ in done)
        return (time.perf_counter() - begun) / number
