"""How often an active design certifies a wrong posterior of a model that is hard to learn, or easy to be fooled by.

The models have two unknown inputs in the unit box and an interface of 21 heights, changes of one smooth model. The
observation is their own interface at `TRUTH`, with noise. The true posterior is integrated on a grid. Wrong means off
by more than 0.3 standard deviations in a mean, or a quarter in a width; "said" counts wrong ones where the certificate
states that a region as small as the one that was missed may have been.

    python -m verification.validation.active.certified [--seeds 40] [--unseen 0.1] [--runs 120]
        [--workers 2] [MODEL ...]
"""

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np
from jaxtyping import Bool, Float
from verification.validation.active.designs import play
from verification.validation.tables import arguments, show, table

from strandline.design import sobol
from strandline.design.active import Active, ActiveDesign, State, learn, posterior_state
from strandline.design.active.coverage_runs import least_found
from strandline.discrepancy import TrackedPoints
from strandline.interface import Interface, Observation
from strandline.likelihood import InterfaceLikelihood
from strandline.numerics.threads import use_double
from strandline.parameters import Parameter, ParameterSpace
from strandline.posterior import Weighted
from strandline.priors import Uniform
from strandline.runs import RunRecord

X = np.linspace(0.0, 1.0, 21)
TRUTH = np.array([0.3, 0.35])
SPACE = ParameterSpace((Parameter("a", Uniform(0.0, 1.0)), Parameter("b", Uniform(0.0, 1.0))))
Inputs = Float[np.ndarray, "run 2"]
Heights = Float[np.ndarray, "run 21"]
NOISE = 0.02
MEAN_OFF, WIDTH_OFF = 0.3, 0.25
GRID = 400


def _smooth(x: Inputs) -> Heights:
    a, b = x[:, :1], x[:, 1:2]
    return np.asarray(0.3 * np.sin(2 * a + X) * X + 0.4 * b * X**2 + 0.2 * a * b * np.sin(3 * X))


def _nowhere(x: Inputs) -> Bool[np.ndarray, " run"]:
    return np.zeros(len(x), bool)


@dataclass(frozen=True)
class Model:
    """A model of the unit box.

    Args:
        heights: Heights of the interface at 21 places.
        fails: Where runs fail.
        share: Share of the box in which the model is not smooth; 0 if that does not matter.
    """

    heights: Callable[[Inputs], Heights] = _smooth
    fails: Callable[[Inputs], Bool[np.ndarray, " run"]] = _nowhere
    share: float = 0.0

    def run(self, x: Float[np.ndarray, " 2"]) -> RunRecord:
        key, inputs = x.tobytes().hex(), SPACE.as_mapping(x)
        if self.fails(x[None])[0]:
            return RunRecord(key, inputs, "failed", failure_kind="planted")
        y = self.heights(x[None])[0]
        return RunRecord(key, inputs, "ok", {"": Interface.polyline(np.stack([X, y], axis=1))})


def pocket(share: float, seed: int) -> Model:
    """Return the smooth model with a disc of this share of the box in which it turns into what was observed.

    The disc lies inside the box, at least its radius away from the first mode; the seed is that of its place.
    """
    radius, random = math.sqrt(share / math.pi), np.random.default_rng([7, seed])
    while np.linalg.norm((middle := random.uniform(radius, 1 - radius, 2)) - TRUTH) <= radius + 0.15:
        pass

    def heights(x: Inputs) -> Heights:
        apart = np.linalg.norm(x - middle, axis=1) / radius
        return _turned(x, apart, _smooth(TRUTH + 0.5 * (x - middle)))

    return Model(heights, share=share)


def ridge(seed: int) -> Model:
    """Return the smooth model with a curved strip along which it fits the observation; it covers 15 % of the box."""
    half, bend = 0.075, np.random.default_rng([9, seed]).uniform(-0.1, 0.1)

    def heights(x: Inputs) -> Heights:
        line = 0.85 + bend * np.cos(np.pi * x[:, 0]) - 0.05
        along = np.stack([TRUTH[0] + 0.02 * (x[:, 0] - 0.5), TRUTH[1] + (x[:, 1] - line)], axis=1)
        return _turned(x, np.abs(x[:, 1] - line) / half, _smooth(along))

    return Model(heights, share=2 * half)


def _turned(x: Inputs, apart: Float[np.ndarray, " run"], into: Heights) -> Heights:
    inside = np.where(apart < 1, (1 - np.minimum(apart, 1) ** 2) ** 2, 0.0)
    plain = _smooth(x)
    return np.asarray(plain + inside[:, None] * (into - plain))


def kink(seed: int) -> Model:
    """Return a model with a kink that crosses the posterior."""
    at = TRUTH[0] + 0.02 * np.random.default_rng([10, seed]).standard_normal()
    return Model(lambda x: _smooth(x) + 0.5 * np.maximum(x[:, :1] - at, 0.0) * np.sin(5 * X))


def failing(seed: int) -> Model:
    """Return a model whose runs fail where the posterior has its half: on one side of a line through the truth."""
    angle = np.random.default_rng([12, seed]).uniform(0, 2 * np.pi)
    normal = np.array([np.cos(angle), np.sin(angle)])
    return Model(fails=lambda x: (x - TRUTH) @ normal > 0.0)


MODELS: dict[str, Callable[[int], Model]] = {
    "smooth": lambda seed: Model(),
    "pocket of 15%": lambda seed: pocket(0.15, seed),
    "pocket of 8%": lambda seed: pocket(0.08, seed),
    "pocket of 4%": lambda seed: pocket(0.04, seed),
    "ridge": ridge,
    "kink": kink,
    "failing": failing,
}
"""Models by name; each is given a seed of what varies in it."""


def true_moments(model: Model, seen: Interface) -> Weighted:
    """Return the true posterior on a grid: only where runs succeed."""
    g = (np.arange(GRID) + 0.5) / GRID
    x = np.stack([one.ravel() for one in np.meshgrid(g, g)], axis=1)
    log = -0.5 * ((model.heights(x) - seen.points[:, 1]) ** 2).sum(axis=1) / NOISE**2
    log[model.fails(x)] = -np.inf
    weights = np.exp(log - log.max())
    return Weighted(x, weights / weights.sum())


def played(name: str, seed: int, active: Active) -> tuple[bool, bool, int, float]:
    """Return whether a design on a model of this name converged, and is right, its runs, and the least region found."""
    random, model = np.random.default_rng([8, seed]), MODELS[name](seed)
    heights = model.heights(TRUTH[None])[0] + NOISE * random.standard_normal(len(X))
    seen = Interface.polyline(np.stack([X, heights], axis=1))
    observations, measure = (Observation(seen, NOISE**2),), TrackedPoints()
    likelihood = InterfaceLikelihood(observations, measure)

    def posterior(x: Inputs, records: Sequence[RunRecord]) -> State:
        known = learn(x, records, SPACE, observations, measure)
        return posterior_state(known, SPACE, (seed, len(x)), before=design.state)

    functions = {
        "learn": posterior,
        "log_likelihood": lambda record: likelihood(record.interfaces),
        "afresh": lambda state: posterior_state(state.knowledge, SPACE, (seed, len(state.knowledge.x), 1)),
    }
    design = ActiveDesign(active, SPACE, batch=4, seed=seed, scramble=seed, **functions)
    *_, (x, _, _) = play(design, sobol(8, 2, scramble=seed), lambda x: [model.run(row) for row in x])
    true = true_moments(model, seen)
    off = np.abs(design.state.mean - true.mean) / true.sd
    width = np.abs(np.log(design.state.sd / true.sd))
    right = bool(off.max() < MEAN_OFF and width.max() < WIDTH_OFF)
    return design.converged, right, len(x), least_found(x, SPACE)


def rows(names: Sequence[str], seeds: int, active: Active, workers: int) -> Iterator[tuple]:
    """Yield a row for each model."""
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=use_double) as pool:
        for name in names:
            found = zip(*pool.map(played, [name] * seeds, range(seeds), [active] * seeds), strict=True)
            converged, right, runs, region = map(np.array, found)
            wrong, share = converged & ~right, MODELS[name](0).share
            said = wrong & (region > share) & (share > 0)
            counts = (int(some.sum()) for some in (converged, wrong, said, right))
            yield name, seeds, *counts, float(np.median(runs)), int(runs.max())


if __name__ == "__main__":
    given = arguments(__doc__, words=MODELS, seeds=40, unseen=0.1, runs=120, workers=2)
    heading = (
        "model | designs {d} | converged {d} | wrong of these {d} | said {d} | right {d} | runs, median {g} | most {d}"
    )
    active = Active(runs=given.runs, unseen=given.unseen)
    found = rows(given.words or [*MODELS], given.seeds, active, given.workers)
    show([table("certified", "Posteriors of hard models", heading, found, live=True)])
