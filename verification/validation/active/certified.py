"""How often an active design certifies a wrong posterior of a model that is hard to learn, or easy to be fooled by.

The models have two or three unknown inputs in the unit box, and an interface of 21 heights; those with two inputs are
changes of one smooth model. The observation is their own interface at `Model.truth`, with noise. The true posterior is
integrated on a grid. Wrong means off by more than 0.3 standard deviations in a mean, or a quarter in a width; "said"
counts wrong ones where the certificate states that a region as small as the one that was missed may have been.

    python -m verification.validation.active.certified [--seeds 40] [--unseen 0.1] [--runs 120]
        [--workers 2] [MODEL ...]
"""

import hashlib
import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np
from jaxtyping import Bool, Float
from verification.validation.tables import arguments, show, table

from strandline.design import sobol
from strandline.design.active import Active, ActiveDesign, State, learn, posterior_state
from strandline.design.active.active_design import Batch
from strandline.design.active.coverage_runs import least_found
from strandline.discrepancy import TrackedPoints
from strandline.foundations import TooFewRuns, one_thread, use_double
from strandline.interface import Interface, Observation
from strandline.likelihood import InterfaceLikelihood
from strandline.parameters import Parameter, ParameterSpace, Uniform
from strandline.posterior import Weighted
from strandline.runs import RunRecord

X = np.linspace(0.0, 1.0, 21)
TRUTH = np.array([0.3, 0.35])

Inputs = Float[np.ndarray, "run dim"]
Heights = Float[np.ndarray, "run 21"]
NOISE = 0.02
MEAN_OFF, WIDTH_OFF = 0.3, 0.25
GRID = {2: 400, 3: 100}


@dataclass(frozen=True)
class Model:
    """A model of the unit box.

    Args:
        heights: Heights of the interface at 21 places.
        truth: Inputs of the observation.
        fails: Where runs fail.
        share: Share of the box in which the model is not smooth; 0 if that does not matter.
        chance: Function that returns what differs between the interfaces of two equal runs, or None.
    """

    heights: Callable[[Inputs], Heights]
    truth: Float[np.ndarray, " dim"]
    fails: Callable[[Inputs], Bool[np.ndarray, " run"]] = lambda x: np.zeros(len(x), bool)
    share: float = 0.0
    chance: Callable[[Float[np.ndarray, " dim"]], Float[np.ndarray, " 21"]] | None = None

    @property
    def space(self) -> ParameterSpace:
        return ParameterSpace(tuple(Parameter(name, Uniform(0.0, 1.0)) for name in "abc"[: len(self.truth)]))

    def run(self, x: Float[np.ndarray, " dim"]) -> RunRecord:
        key, inputs = x.tobytes().hex(), self.space.as_mapping(x)
        if self.fails(x[None])[0]:
            return RunRecord(key, inputs, "failed", failure_kind="planted")
        y = self.heights(x[None])[0] + (0.0 if self.chance is None else self.chance(x))
        return RunRecord(key, inputs, "ok", {"": Interface.polyline(np.stack([X, y], axis=1))})


def smooth(x: Inputs) -> Heights:
    """Return the heights of the smooth model that the others change."""
    a, b = x[:, :1], x[:, 1:2]
    return np.asarray(0.3 * np.sin(2 * a + X) * X + 0.4 * b * X**2 + 0.2 * a * b * np.sin(3 * X))


def pocket(share: float, seed: int, *, off: float = 0.0) -> Model:
    """Return the smooth model with a disc in which it turns into what was observed.

    The disc lies inside the box, at least its radius away from the first mode.

    Args:
        share: Its share of the box; 0: there is none.
        seed: Seed of its place.
        off: Heights by which its middle misses the observation, so that the mode there is lighter.
    """
    if not share:
        return Model(smooth, TRUTH)
    radius, random = math.sqrt(share / math.pi), np.random.default_rng([7, seed])
    while np.linalg.norm((middle := random.uniform(radius, 1 - radius, 2)) - TRUTH) <= radius + 0.15:
        pass

    def heights(x: Inputs) -> Heights:
        apart = np.linalg.norm(x - middle, axis=1) / radius
        return _turned(x, apart, smooth(TRUTH + 0.5 * (x - middle)) + off * np.cos(3 * np.pi * X))

    return Model(heights, TRUTH, share=share)


def ridge(seed: int) -> Model:
    """Return the smooth model with a curved strip along which it fits the observation; it covers 15 % of the box."""
    half, bend = 0.075, np.random.default_rng([9, seed]).uniform(-0.1, 0.1)

    def heights(x: Inputs) -> Heights:
        line = 0.85 + bend * np.cos(np.pi * x[:, 0]) - 0.05
        along = np.stack([TRUTH[0] + 0.02 * (x[:, 0] - 0.5), TRUTH[1] + (x[:, 1] - line)], axis=1)
        return _turned(x, np.abs(x[:, 1] - line) / half, smooth(along))

    return Model(heights, TRUTH, share=2 * half)


def _turned(x: Inputs, apart: Float[np.ndarray, " run"], into: Heights) -> Heights:
    inside = np.where(apart < 1, (1 - np.minimum(apart, 1) ** 2) ** 2, 0.0)
    plain = smooth(x)
    return np.asarray(plain + inside[:, None] * (into - plain))


def kink(seed: int) -> Model:
    """Return a model with a kink that crosses the posterior."""
    at = _near(10, seed)
    return Model(lambda x: smooth(x) + 0.5 * np.maximum(x[:, :1] - at, 0.0) * np.sin(5 * X), TRUTH)


def jump(seed: int) -> Model:
    """Return a model that jumps by several noise lengths along a line through the posterior."""
    at = _near(11, seed)
    return Model(lambda x: smooth(x) + 0.04 * (x[:, :1] > at) * np.sin(4 * X), TRUTH)


def _near(kind: int, seed: int) -> float:
    return TRUTH[0] + 0.02 * np.random.default_rng([kind, seed]).standard_normal()


def failing(seed: int) -> Model:
    """Return a model whose runs fail where the posterior has its half: on one side of a line through the truth."""
    angle = np.random.default_rng([12, seed]).uniform(0, 2 * np.pi)
    normal = np.array([np.cos(angle), np.sin(angle)])
    return Model(smooth, TRUTH, lambda x: (x - TRUTH) @ normal > 0.0)


def branches(seed: int) -> Model:
    """Return a model with two branches: above a line near the posterior, either may be returned."""
    at = TRUTH[1] + 0.05 * np.random.default_rng([13, seed]).standard_normal()

    def other(x: Float[np.ndarray, " dim"]) -> Float[np.ndarray, " 21"]:
        either = x[1] > at and hashlib.sha256(x.tobytes()).digest()[0] < 128
        return np.asarray(0.3 * np.sin(2 * X) * either)

    return Model(smooth, TRUTH, chance=other)


def jitter(share: float, seed: int) -> Model:
    """Return the smooth model with a scatter of this share of its displacement."""

    def by_chance(x: Float[np.ndarray, " dim"]) -> Float[np.ndarray, " 21"]:
        random = np.random.default_rng([14, seed, *hashlib.sha256(x.tobytes()).digest()[:8]])
        waves = np.cos(np.pi * np.arange(4)[:, None] * X) / math.sqrt(2.5)
        size = float(np.sqrt(np.mean(smooth(x[None]) ** 2)))
        return np.asarray(share * size * (random.standard_normal(4) @ waves))

    return Model(smooth, TRUTH, chance=by_chance)


def four_modes(seed: int) -> Model:
    """Return a model of three inputs with four equal modes, symmetric in two of the inputs."""
    del seed

    def heights(x: Inputs) -> Heights:
        a, b, c = ((x[:, 0] - 0.5) ** 2)[:, None], ((x[:, 1] - 0.5) ** 2)[:, None], x[:, 2:]
        return np.asarray(1.5 * a * X + 1.5 * b * X**3 + 0.3 * c * np.sin(3 * X))

    return Model(heights, np.array([0.8, 0.75, 0.4]))


MODELS: dict[str, Callable[[int], Model]] = {
    "none": lambda seed: pocket(0.0, seed),
    "pocket of 15%": lambda seed: pocket(0.15, seed),
    "pocket of 8%": lambda seed: pocket(0.08, seed),
    "pocket of 4%": lambda seed: pocket(0.04, seed),
    "lighter mode in a pocket of 15%": lambda seed: pocket(0.15, seed, off=0.006),
    "ridge": ridge,
    "kink": kink,
    "jump": jump,
    "failing": failing,
    "branches": branches,
    "jitter of 1%": lambda seed: jitter(0.01, seed),
    "jitter of 3%": lambda seed: jitter(0.03, seed),
    "four modes": four_modes,
}
"""Models by name; each is given a seed of what varies in it."""


def true_moments(model: Model, seen: Interface) -> Weighted:
    """Return the true posterior on a grid: without the scatter of a model, and only where its runs succeed."""
    dim = len(model.truth)
    g = (np.arange(GRID[dim]) + 0.5) / GRID[dim]
    x = np.stack([one.ravel() for one in np.meshgrid(*[g] * dim)], axis=1)
    log = -0.5 * ((model.heights(x) - seen.points[:, 1]) ** 2).sum(axis=1) / NOISE**2
    log[model.fails(x)] = -np.inf
    weights = np.exp(log - log.max())
    return Weighted(x, weights / weights.sum())


@dataclass(frozen=True)
class Found:
    """How a design ended."""

    converged: bool
    right: bool
    runs: int
    region: float
    reason: str


def played(model: Model, seed: int, active: Active) -> Found:
    """Return how an active design on the model ends, beside the true posterior."""
    random, space = np.random.default_rng([8, seed]), model.space
    heights = model.heights(model.truth[None])[0] + NOISE * random.standard_normal(len(X))
    seen = Interface.polyline(np.stack([X, heights], axis=1))
    observations, measure = (Observation(seen, NOISE**2),), TrackedPoints()
    likelihood = InterfaceLikelihood(observations, measure)

    def posterior(x: Float[np.ndarray, "run dim"], records: Sequence[RunRecord]) -> State:
        known = learn(x, records, space, observations, measure)
        return posterior_state(known, space, (seed, len(x)), before=design.state)

    functions = {
        "learn": posterior,
        "log_likelihood": lambda record: likelihood(record.interfaces),
        "afresh": lambda state: posterior_state(state.knowledge, space, (seed, len(state.knowledge.x), 1)),
    }
    design = ActiveDesign(active, space, batch=4, seed=seed, scramble=seed, **functions)
    x = space.to_physical(sobol(4 + 2 * space.dim, space.dim, scramble=seed))
    design.start(x)
    records = [model.run(row) for row in x]
    while (batch := _next(design, x, records)) is not None:
        x, records = np.concatenate([x, batch.points]), records + [model.run(row) for row in batch.points]
    true = true_moments(model, seen)
    off = np.abs(design.state.mean - true.mean) / true.sd
    width = np.abs(np.log(design.state.sd / true.sd))
    right = bool(off.max() < MEAN_OFF and width.max() < WIDTH_OFF)
    reason = "scatter" if design.scattered else "; ".join(design.reasons[1:2])
    return Found(design.converged, right, len(x), least_found(x, space), reason)


def _next(design: ActiveDesign, x: Float[np.ndarray, "run dim"], records: Sequence[RunRecord]) -> Batch | None:
    try:
        with one_thread():
            return design.next(x, records)
    except TooFewRuns:
        return design.more_of_the_first()


def _task(name: str, seed: int, active: Active) -> Found:
    return played(MODELS[name](seed), seed, active)


def rows(names: Sequence[str], seeds: int, active: Active, workers: int) -> Iterator[tuple]:
    """Yield a row for each model."""
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=use_double) as pool:
        for name in names:
            found = [*pool.map(_task, [name] * seeds, range(seeds), [active] * seeds)]
            wrong = [one for one in found if one.converged and not one.right]
            said = sum(one.region > MODELS[name](0).share > 0 for one in wrong)
            runs = np.array([one.runs for one in found])
            ended = sum(one.converged for one in found), len(wrong), said, sum(one.right for one in found)
            print(*Counter(one.reason for one in found if not one.converged).most_common(1))
            yield name, len(found), *ended, float(np.median(runs)), int(runs.max())


if __name__ == "__main__":
    given = arguments(__doc__, words=MODELS, seeds=40, unseen=0.1, runs=120, workers=2)
    heading = (
        "model | designs {d} | converged {d} | wrong of these {d} | said {d} | right {d} | runs, median {g} | most {d}"
    )
    active = Active(runs=given.runs, unseen=given.unseen)
    found = rows(given.words or [*MODELS], given.seeds, active, given.workers)
    show([table("certified", "Posteriors of hard models", heading, found, live=True)])
