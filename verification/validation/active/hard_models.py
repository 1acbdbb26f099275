"""Models that a surrogate of the field cannot follow, or whose posterior is easily missed.

All have two or three unknown inputs in the unit box, and an interface of 21 heights. Those with two inputs are changes
of one smooth model; the observation is their own interface at `Model.truth`, with noise.
"""

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from strandline.interface import Interface
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import Uniform
from strandline.runs import RunRecord

X = np.linspace(0.0, 1.0, 21)
TRUTH = np.array([0.3, 0.35])

Inputs = Float[np.ndarray, "run dim"]
Heights = Float[np.ndarray, "run 21"]


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
        """The unknown inputs."""
        return ParameterSpace(tuple(Parameter(name, Uniform(0.0, 1.0)) for name in "abc"[: len(self.truth)]))

    def run(self, x: Float[np.ndarray, " dim"]) -> RunRecord:
        """Return the record of a run."""
        key, inputs = x.tobytes().hex(), self.space.as_mapping(x)
        if self.fails(x[None])[0]:
            return RunRecord(key, inputs, "failed", failure_kind="planted")
        y = self.heights(x[None])[0] + (0.0 if self.chance is None else self.chance(x))
        return RunRecord(key, inputs, "ok", {"": Interface.polyline(np.stack([X, y], axis=1))})


def smooth(x: Inputs) -> Heights:
    """Return the heights of a smooth model of two inputs."""
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
    at = TRUTH[0] + 0.02 * np.random.default_rng([10, seed]).standard_normal()
    return Model(lambda x: smooth(x) + 0.5 * np.maximum(x[:, :1] - at, 0.0) * np.sin(5 * X), TRUTH)


def jump(seed: int) -> Model:
    """Return a model that jumps by several noise lengths along a line through the posterior."""
    at = TRUTH[0] + 0.02 * np.random.default_rng([11, seed]).standard_normal()
    return Model(lambda x: smooth(x) + 0.04 * (x[:, :1] > at) * np.sin(4 * X), TRUTH)


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
