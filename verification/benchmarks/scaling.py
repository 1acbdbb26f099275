"""How times grow with size, and which share of one core's peak they reach: verification/benchmarks/scaling.json.

Everything runs on one core, in core-seconds, which depend less on other work on the machine than wall seconds. The peak
of a core is measured here: products of matrices (for the fit: n³ operations for Cholesky factor and inverse), and
exponentials by JAX of numbers that stay in the cache (for mean, sampler and currents: one per pair, without pairs that
symmetry saves; narrow currents leave out most pairs and have no share). A share ignores the other costs of a pair.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from verification.benchmarks import results, surrogate
from verification.benchmarks.figures import Figure
from verification.benchmarks.norms import NARROW, WIDE, sheet
from verification.benchmarks.peers.worker import limit_cores

from strandline import Currents
from strandline.design import sobol
from strandline.smc import SMCSettings, sample
from strandline.surrogate import KERNELS, GaussianProcess, batched_mean, condition
from strandline.surrogate.hyperparameters import Objective

RUNS = (250, 500, 1000, 2000, 4000)
PARTICLES = (1000, 2000, 4000, 8000, 16_000)
DIMENSIONS = (2, 3, 4, 5, 6, 7, 8)
NODES = (23, 40, 72, 123, 225)
"""Nodes along an edge of a sheet: about 10³ … 10⁵ triangles."""
FIXED_RUNS, FIXED_PARTICLES, NUGGET = 1000, 4000, 5e-3
GEMM, EXPONENTIALS = "GEMM", "exponentials"
Task = Callable[[], float]
LONG = 3.0
"""Core-seconds above which a task is timed once."""


def figures() -> Iterator[Figure]:
    """Yield the shares at the largest sizes; print each series as it is measured, and write all of them."""
    limit_cores(1)
    jax.config.update("jax_enable_x64", True)
    peaks, found = {GEMM: gemm_peak(), EXPONENTIALS: exponential_peak()}, []
    for name, rate in peaks.items():
        yield Figure("peak of one core", name, rate, "per core-second")
    for series in _all_series():
        found.append(series)
        last, limit = series["points"][-1], series["limit"]
        if limit is not None:
            case, share = f"{series['axis']} = {last['x']}", 100 * last["operations"] / last["seconds"] / peaks[limit]
            yield Figure(f"share of the peak: {series['name']}", case, share, "%", f"of {limit}")
    results.write(results.SCALING, {"peaks": peaks, "series": found})


def _all_series() -> Iterator[dict[str, Any]]:
    yield measured("fit, 7 inputs", "runs", GEMM, RUNS, partial(fit, inputs=7))
    yield measured("sampler, 2 inputs, 1000 runs", "particles", EXPONENTIALS, PARTICLES, sampling)
    yield measured("fit, 1000 runs", "inputs", GEMM, DIMENSIONS, partial(fit, FIXED_RUNS))
    yield measured("mean, 1000 runs, 4000 points", "inputs", EXPONENTIALS, DIMENSIONS, mean)
    for width, limit in ((NARROW, None), (WIDE, EXPONENTIALS)):
        yield measured(f"currents, width {width}", "triangles", limit, NODES, partial(currents, width))


def measured(
    name: str, axis: str, limit: str | None, sizes: Sequence[int], prepare: Callable[[int], Task]
) -> dict[str, Any]:
    """Return the core-seconds of a task at each size, after a first, unmeasured call, and its number of operations.

    `limit` names the peak that its operations are a share of, if any.
    """
    points = []
    for size in sizes:
        task = prepare(size)
        task()
        seconds, operations = least(task)
        x = 2 * (size - 1) ** 2 if axis == "triangles" else size
        points.append({"x": x, "seconds": seconds, "operations": operations})
        print(f"{name:<32} {axis} {x:>7} {seconds:>10.4g} s", flush=True)
    return {"name": name, "axis": axis, "limit": limit, "points": points}


def least(task: Callable[[], float], repeats: int = 3) -> tuple[float, float]:
    """Return the fewest core-seconds of some calls, or those of a single long call, and the operations."""
    best = float("inf")
    for _ in range(repeats):
        begun = time.process_time()
        operations = task()
        best = min(best, time.process_time() - begun)
        if best > LONG:
            break
    return best, operations


def rate(task: Task) -> float:
    """Return the operations per core-second of a task, after an unmeasured call."""
    task()
    seconds, operations = least(task)
    return operations / seconds


def gemm_peak(size: int = 1500) -> float:
    """Return the operations per core-second of a matrix product."""
    a = np.random.default_rng(0).random((size, size))
    out = np.empty_like(a)

    def task() -> float:
        np.matmul(a, a, out=out)
        return 2.0 * size**3

    return rate(task)


def exponential_peak(size: int = 2**13, rounds: int = 4000) -> float:
    """Return the exponentials per core-second by JAX, of an array that stays in the cache."""

    @jax.jit
    def repeated(x: jax.Array) -> jax.Array:
        return jax.lax.fori_loop(0, rounds, lambda _, total: jnp.exp(-total), x)

    x = jnp.linspace(0.1, 1.0, size)

    def task() -> float:
        repeated(x).block_until_ready()
        return float(size * rounds)

    return rate(task)


def fit(runs: int, inputs: int) -> Task:
    """Return a task: the evidence of a product kernel with its gradient."""
    x, y = training(runs, inputs)
    objective = Objective(x, y, KERNELS["matern32_product"], NUGGET)
    log_lengths = [0.5] * inputs

    def task() -> float:
        objective.evidence(float(np.log(surrogate.VARIANCE)) - 1.5, log_lengths)
        return float(runs) ** 3

    return task


def mean(inputs: int) -> Task:
    """Return a task: the mean of a product kernel at the particles."""
    x, y = training(FIXED_RUNS, inputs)
    compiled = jax.jit(batched_mean(_conditioned(x, y, "matern32_product", np.full(inputs, 2.0))))
    points = jnp.asarray(np.random.default_rng(1).normal(size=(FIXED_PARTICLES, inputs)))

    def task() -> float:
        compiled(points).block_until_ready()
        return float(FIXED_PARTICLES * FIXED_RUNS)

    return task


def sampling(particles: int) -> Task:
    """Return a task: the sampler with five moves on a ridge."""
    x, y = training(FIXED_RUNS, 2)
    log_likelihood = batched_mean(_conditioned(x, y, "matern32", 1.3))
    initial = np.random.default_rng(1).uniform(x.min(), x.max(), (particles, 2))
    settings = SMCSettings(rejuvenation_steps=5)

    def flat(x: jax.Array) -> jax.Array:  # one function: another in each call would be compiled again
        return jnp.zeros(len(x))

    def task() -> float:
        found = sample(jax.random.key(1), log_likelihood, flat, initial, settings=settings)
        return float(found.likelihood_evaluations * FIXED_RUNS)

    return task


def _conditioned(x: np.ndarray, y: np.ndarray, kernel: str, length: float | np.ndarray) -> GaussianProcess:
    fixed = {"length_scale": length, "signal_variance": surrogate.VARIANCE, "nugget": NUGGET}
    return condition(x, y, kernel=KERNELS[kernel], **fixed)


def currents(width: float, nodes: int) -> Task:
    """Return a task: d² of a simulated surface; the norm of the observed one is known after the first call."""
    simulated, observed = sheet(nodes, bend=0.20), sheet(nodes, bend=0.21)
    measure, number = Currents(width, quadrature="centre"), len(simulated.cells)

    def task() -> float:
        measure(simulated, observed)
        return number**2 + 0.5 * number * (number + 1)

    return task


def training(runs: int, inputs: int) -> tuple[np.ndarray, np.ndarray]:
    """Return standardised inputs and a centred ridge."""
    u = sobol(runs, inputs)
    y = -30.0 * (u[:, 0] * (1 + u[:, -1] ** 2) - 0.6) ** 2
    return (u - u.mean(0)) / u.std(0), y - y.mean()
