"""The mean of the Gaussian process and the sampler compared with other programs: wall seconds and core-seconds.

All get the same surrogate. Means must agree to 1e-9, whole posteriors within the tolerances of `require_right`, or the
benchmark stops. Schedules of temperatures differ in their numbers of evaluations, so samplers are compared by the
seconds of one evaluation of the log-likelihood. If only a part of a program is timed, the remark says so.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_solve
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern
from verification.benchmarks import inference, surrogate
from verification.benchmarks.figures import Figure, in_turns

from strandline.design import sobol
from strandline.foundations import WIDEST
from strandline.posterior import Weighted
from strandline.posterior.quadrature import integrate
from strandline.smc import SMCSettings, sample
from strandline.smc.sampler import spread as over_devices
from strandline.surrogate import KERNELS, batched_mean, condition

RUNS, LENGTH, VARIANCE, NUGGET, PARTICLES, MOVES, ZETA = 1000, 1.3, 500.0, 5e-4, 5000, 20, 0.995
PARTS_RUNS, PARTS_PARTICLES, PARTS_MOVES, PARTS_ZETA = 2000, 10_000, 30, 0.998
TOLERANCE_MOMENTS, TOLERANCE_EVIDENCE = 0.05, 0.1
COLD = """
import json, sys, time
from verification.benchmarks import sampler
print(json.dumps(sampler.first_and_second_call()))
"""
Log = Callable[[Any], Any]


@dataclass(frozen=True)
class Cost:
    """Cost of a task: wall seconds, seconds of all cores, evaluations of the log-likelihood."""

    wall: float
    cpu: float
    evaluations: int


@dataclass(frozen=True, eq=False)
class Task:
    """A surrogate of a log-likelihood under the uniform prior of the unit cube, and the initial particles."""

    process: Any
    mean: Log
    initial: np.ndarray


def figures() -> Iterator[Figure]:
    """Yield the figures of the mean and of the sampler."""
    task, seven = two_inputs(RUNS), parts(PARTS_RUNS)
    yield mean_beside(task, _scikit_learn_of_two(task), "GP mean, 2 inputs", 9)
    yield mean_beside(seven, scikit_learn_of_seven(seven), "GP mean, 7 inputs, product", 5)
    yield from whole_runs(task)
    yield seven_inputs(seven)
    yield compilation()


def mean_beside(task: Task, peer: Log, what: str, repeats: int) -> Figure:
    """Compare the mean at the sampler's particles."""
    compiled, points = jax.jit(task.mean, compiler_options=WIDEST), over_devices(jnp.asarray(task.initial))

    def ours() -> Any:
        return np.asarray(compiled(points))

    np.testing.assert_allclose(ours(), peer(task.initial), rtol=1e-9, atol=1e-8)
    number = len(points)
    costs = [(_metered(ours, number), _metered(lambda: peer(task.initial), number)) for _ in range(repeats)]
    whole = f"{what}, n = {len(task.process.alpha)}, {number} points"
    return figure(whole, "scikit-learn predict", costs, remark="clock: on all cores; scikit-learn computes on one")


def whole_runs(task: Task, moves: int = MOVES, zeta: float = ZETA, repeats: int = 3) -> Iterator[Figure]:
    """Yield the sampler in the study's settings compared with others; each run is whole or only its first steps."""
    settings = SMCSettings(rejuvenation_steps=moves, zeta=zeta)
    exact = integrate(task.process.mean, np.zeros(2), np.ones(2))
    spread = 0.5 * exact.sd
    what = f"SMC, {len(task.initial)} particles, {moves} moves, ζ {zeta}"
    ours = partial(strandline_run, task, settings)
    naive = blackjax_run(task, naive_mean(task.process), spread, moves, zeta)
    refactored = blackjax_run(task, refactoring_mean(task.process), spread, moves, zeta)
    peer = _scikit_learn_of_two(task)
    for found in (ours()[0], naive()[0]):
        require_right(found, exact)
    busy: list[Cost] = []

    def beside(name: str, other: Callable[[], Any], remark: str) -> Figure:
        costs = []
        for _ in range(repeats):
            costs.append((ours()[1], other()[1]))
            busy.append(costs[-1][0])
        return figure(what, name, costs, remark, unit="s per evaluation")

    criterion = "its own criterion; evaluations: particles × (moves + 3) × steps"
    yield beside("BlackJAX, (B, n) @ α", naive, criterion)
    part = 2
    refactored(part)
    yield beside(
        "BlackJAX, K factorised at each call",
        partial(refactored, part),
        f"the first {part} tempering steps are timed; JAX factorises once for all particles of a move",
    )
    yield beside(
        "scikit-learn predict, NumPy loop",
        partial(numpy_run, task, peer, spread, moves, zeta, part),
        f"the first {part} tempering steps are timed",
    )
    remark = f"ratio: core-seconds per second; {os.cpu_count()} cores, load of the machine {os.getloadavg()[0]:.1f}"
    pairs = [(cost, replace(cost, wall=cost.cpu)) for cost in busy]
    yield figure("cores kept busy while sampling", "one core", pairs, remark)


def seven_inputs(task: Task, moves: int = PARTS_MOVES, zeta: float = PARTS_ZETA) -> Figure:
    """Compare the default settings with the study's on the same surrogate, and report how far the moments differ."""
    default = SMCSettings()
    strandline_run(task, default)
    (study, theirs), *ours = [
        strandline_run(task, SMCSettings(rejuvenation_steps=moves, zeta=zeta)),
        *(strandline_run(task, default, seed) for seed in (1, 2, 3)),
    ]
    mean, sd = moments(study)
    apart = [np.concatenate([(m - mean) / sd, s / sd - 1]) for m, s in (moments(one) for one, _ in ours)]
    worst = max(float(np.abs(one).max()) for one in apart)
    root = float(np.sqrt(np.mean(np.square(apart))))
    middle = _median([cost for _, cost in ours])
    remark = (
        f"ratios of whole runs, {theirs.evaluations / middle.evaluations:.0f} times the evaluations; study run once, "
        f"the defaults with 3 seeds; means and sd apart by {root:.3f} sd (rms), {worst:.3f} (worst)"
    )
    what = f"SMC, 7 inputs, n = {len(task.process.alpha)}, {len(task.initial)} particles"
    return figure(what, f"{moves} moves, ζ {zeta}, ours too", [(middle, theirs)], remark)


def compilation(repeats: int = 3) -> Figure:
    """Return how many seconds the first sampling of a process takes longer than the second."""
    kinds: list[list[float]] = [[], []]
    for _ in range(repeats):
        with tempfile.TemporaryDirectory() as folder:
            for kind in kinds:
                chosen = {**os.environ, "JAX_COMPILATION_CACHE_DIR": folder}
                ended = subprocess.run([sys.executable, "-c", COLD], check=True, env=chosen, capture_output=True)
                first, second = json.loads(ended.stdout)
                kind.append(first - second)
    what, peer = "compiling the sampler, 2 inputs", "the same without kept programs"
    remark = "seconds that the first sampling takes longer than the second; ours: from the cache of a former process"
    return in_turns(what, peer, list(zip(*reversed(kinds), strict=True)), remark=remark)


def first_and_second_call() -> tuple[float, float]:
    """Return the seconds of two samplings of one tempering step and one move."""
    task, settings = two_inputs(RUNS), SMCSettings(rejuvenation_steps=1, zeta=1e-9)
    seconds = [strandline_run(task, settings)[1].wall for _ in "ab"]
    return seconds[0], seconds[1]


def two_inputs(runs: int, particles: int = PARTICLES) -> Task:
    """Return the surrogate of a ridge in two inputs."""
    x, y = (part[:runs] for part in inference.training())
    process = condition(x, y, kernel=KERNELS["matern32"], length_scale=LENGTH, signal_variance=VARIANCE, nugget=NUGGET)
    return Task(process, batched_mean(process), np.random.default_rng(1).random((particles, 2)))


def parts(runs: int, particles: int = PARTS_PARTICLES) -> Task:
    """Return the surrogate of a function of seven inputs: a ridge, a product, and three inputs of little influence."""
    process = condition(
        sobol(runs, 7),
        surrogate.training(runs)[1],
        kernel=KERNELS["matern32_product"],
        length_scale=surrogate.LENGTHS,
        signal_variance=surrogate.VARIANCE,
        nugget=surrogate.NUGGET,
    )
    return Task(process, batched_mean(process), np.random.default_rng(1).random((particles, 7)))


def _scikit_learn_of_two(task: Task) -> Log:
    return scikit_learn(task.process, ConstantKernel(VARIANCE) * Matern(LENGTH, nu=1.5), NUGGET)


def scikit_learn_of_seven(task: Task) -> Log:
    """Return scikit-learn's mean of the surrogate of seven inputs."""
    return scikit_learn(task.process, surrogate.product(), surrogate.NUGGET)


def scikit_learn(process: Any, kernel: Any, nugget: float) -> Log:
    """Return the mean that scikit-learn computes by solving the same equations itself."""
    peer = GaussianProcessRegressor(kernel, alpha=nugget, optimizer=None).fit(process.x_train, centred_targets(process))
    return lambda x: peer.predict((x - process.shift) / process.scale) + process.target_mean


def centred_targets(process: Any) -> np.ndarray:
    """Return the targets less their mean, from the correlations of the runs and α."""
    train = process.x_train / process.length_scale
    correlations = np.stack([process.kernel.value(point - train) for point in train])
    return process.signal_variance * correlations @ process.alpha + process.nugget * process.alpha


def naive_mean(process: Any) -> Log:
    """Return the mean at one point in its simplest form."""
    train, weight = jnp.asarray(process.x_train), jnp.asarray(process.signal_variance * process.alpha)

    def mean(x: Any) -> Any:
        t = jnp.sqrt(3.0) * jnp.linalg.norm((x - process.shift) / process.scale - train, axis=1) / process.length_scale
        return ((1 + t) * jnp.exp(-t)) @ weight + process.target_mean

    return mean


def refactoring_mean(process: Any) -> Log:
    """Return the mean at one point by a function that takes the training data, as `predict` of a library does."""
    train, targets = jnp.asarray(process.x_train), jnp.asarray(centred_targets(process))

    def covariance(a: Any, b: Any) -> Any:
        square = ((a[:, None] - b[None]) ** 2).sum(axis=-1)
        t = jnp.sqrt(3.0) * jnp.sqrt(square) / process.length_scale
        return process.signal_variance * (1 + t) * jnp.exp(-t)

    def mean(x: Any) -> Any:
        K = covariance(train, train) + process.nugget * jnp.eye(len(train))
        alpha = cho_solve((jnp.linalg.cholesky(K), True), targets)
        return (covariance(((x - process.shift) / process.scale)[None], train) @ alpha)[0] + process.target_mean

    return mean


def strandline_run(task: Task, settings: Any, seed: int = 1) -> tuple[Any, Cost]:
    """Return (log evidence, positions, weights) and the cost."""
    begun = _clocks()
    result = sample(jax.random.key(seed), task.mean, unit_prior, task.initial, settings=settings)
    cost = _since(begun, result.likelihood_evaluations)
    return (result.log_evidence, result.positions, np.exp(result.log_weights)), cost


def blackjax_run(task: Task, mean: Log, spread: np.ndarray, moves: int, zeta: float) -> Callable[..., tuple[Any, Cost]]:
    """Return BlackJAX's sampler of the same posterior; its number of steps can be limited."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import blackjax
        from blackjax.smc import resampling
    walk = blackjax.additive_step_random_walk
    kernel = walk.build_kernel()

    def move(key: Any, state: Any, log_density: Log) -> Any:
        return kernel(key, state, log_density, lambda k, x: spread * jax.random.normal(k, x.shape))

    algorithm = blackjax.adaptive_tempered_smc(
        lambda x: unit_prior(x[None])[0], mean, move, walk.init, {}, resampling.systematic, zeta, num_mcmc_steps=moves
    )
    step = jax.jit(algorithm.step)

    def run(steps: int | None = None) -> tuple[Any, Cost]:
        key, state, done, log_evidence = jax.random.key(2), algorithm.init(jnp.asarray(task.initial)), 0, 0.0
        begun = _clocks()
        while float(state.tempering_param) < 1 and done != steps:
            key, now = jax.random.split(key)
            state, info = step(now, state)
            log_evidence += float(info.log_likelihood_increment)
            done += 1
        jax.block_until_ready(state)
        cost = _since(begun, len(task.initial) * (moves + 3) * done)
        return (log_evidence, np.asarray(state.particles), np.asarray(state.weights)), cost

    return run


def numpy_run(
    task: Task, log_likelihood: Log, spread: np.ndarray, moves: int, zeta: float, steps: int | None = None
) -> tuple[Any, Cost]:
    """Return the posterior by a plain loop over temperatures, ESS' = ζ ESS, resampled below half of the particles."""
    rng = np.random.default_rng(3)
    begun = _clocks()
    x, number, gamma, log_evidence, done = task.initial, len(task.initial), 0.0, 0.0, 0
    w, values = np.full(number, 1 / number), log_likelihood(x)

    def reweighted(step: float) -> np.ndarray:
        scaled: np.ndarray = w * np.exp(step * (values - values.max()))
        return scaled

    def size(v: np.ndarray) -> float:
        return float(v.sum() ** 2 / (v**2).sum())

    while gamma < 1 and done != steps:
        low, high = 0.0, 1 - gamma
        if size(reweighted(high)) >= zeta * size(w):
            low = high
        for _ in range(50):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if size(reweighted(middle)) >= zeta * size(w) else (low, middle)
        w = reweighted(low)
        log_evidence += float(np.log(w.sum())) + low * float(values.max())
        gamma, w = gamma + low, w / w.sum()
        if size(w) < 0.5 * number:
            chosen = rng.choice(number, number, p=w)
            x, values, w = x[chosen], values[chosen], np.full(number, 1 / number)
        for _ in range(moves):
            proposal = x + spread * rng.normal(size=x.shape)
            inside = ((proposal >= 0) & (proposal <= 1)).all(axis=1)
            there = log_likelihood(proposal)
            accept = inside & (np.log(rng.random(number)) < gamma * (there - values))
            x, values = np.where(accept[:, None], proposal, x), np.where(accept, there, values)
        done += 1
    return (log_evidence, x, w), _since(begun, number * (1 + moves * done))


def unit_prior(x: Any) -> Any:
    """Return the log density of the uniform prior on the unit cube."""
    return jnp.where(jnp.all((x >= 0) & (x <= 1), axis=1), 0.0, -jnp.inf)


def moments(found: tuple[float, np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean and the standard deviation of weighted particles."""
    weighted = Weighted(*found[1:])
    return weighted.mean, weighted.sd


def require_right(found: tuple[float, np.ndarray, np.ndarray], exact: Any) -> None:
    """Stop if moments (in sd) or log evidence are off by more than the tolerances."""
    mean, sd = moments(found)
    np.testing.assert_allclose((mean - exact.mean) / exact.sd, 0.0, atol=TOLERANCE_MOMENTS)
    np.testing.assert_allclose(sd / exact.sd, 1.0, atol=TOLERANCE_MOMENTS)
    np.testing.assert_allclose(found[0], exact.log_evidence, atol=TOLERANCE_EVIDENCE)


def figure(what: str, peer_name: str, costs: list[tuple[Cost, Cost]], remark: str, unit: str = "s") -> Figure:
    """Return the medians of costs (ours, peer), of the whole task or ``per evaluation``."""
    ours, peer = (_median(list(column)) for column in zip(*costs, strict=True))
    mine, its = (cost.evaluations if unit != "s" else 1 for cost in (ours, peer))
    cores = ours.cpu / mine, peer.cpu / its
    return Figure(what, "", ours.wall / mine, unit, remark, peer_name, peer.wall / its, len(costs), cores)


def _median(costs: list[Cost]) -> Cost:
    wall, cpu = (statistics.median(getattr(cost, name) for cost in costs) for name in ("wall", "cpu"))
    return Cost(wall, cpu, costs[0].evaluations)


def _metered(task: Callable[[], Any], evaluations: int) -> Cost:
    begun = _clocks()
    task()
    return _since(begun, evaluations)


def _clocks() -> tuple[float, float]:
    return time.perf_counter(), time.process_time()


def _since(begun: tuple[float, float], evaluations: int) -> Cost:
    wall, cpu = (now - then for now, then in zip(_clocks(), begun, strict=True))
    return Cost(wall, cpu, evaluations)
