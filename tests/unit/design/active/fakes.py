"""A bent line with two inputs, its surrogate, and posteriors of known moments: shared by tests of active designs."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from strandline.design.active.state import Knowledge, State
from strandline.discrepancy import TrackedPoints
from strandline.errors import TooFewRuns
from strandline.interface import Interface, Observation
from strandline.likelihood import FieldLikelihood
from strandline.parameters import Parameter, ParameterSpace
from strandline.priors import Uniform
from strandline.runs import RunRecord
from strandline.surrogate.feasibility import learn_feasibility
from strandline.surrogate.field import FieldTraining, fit_field

SPACE = ParameterSpace((Parameter("a", Uniform(-1.0, 1.0)), Parameter("b", Uniform(-1.0, 1.0))))
S = np.linspace(0.0, 1.0, 9)
NOISE = 0.02


def interface(x: np.ndarray) -> Interface:
    """Return a line that is bent by the first input and lifted by the second."""
    y = 0.1 * (x[0] * S + np.sin(2 * x[0] + x[1]) * S**2 + 0.5 * x[1])
    return Interface.polyline(np.stack([S, y], axis=1))


def record(x: np.ndarray, *, ok: bool = True) -> RunRecord:
    found = {"": interface(x)} if ok else {}
    return RunRecord(x.tobytes().hex(), SPACE.as_mapping(x), "ok" if ok else "failed", found)


def known(x: np.ndarray, ok: np.ndarray | None = None, *, noise: float = NOISE) -> Knowledge:
    """Return what runs at `x` teach."""
    ok = np.ones(len(x), bool) if ok is None else ok
    return _known(x.astype(float).tobytes(), ok.tobytes(), noise)


@lru_cache
def _known(inputs: bytes, outcomes: bytes, noise: float) -> Knowledge:
    x, ok = np.frombuffer(inputs).reshape(-1, 2), np.frombuffer(outcomes, bool)
    training = FieldTraining(x[ok], [{"": interface(row)} for row in x[ok]], None, SPACE.low, SPACE.high)
    surrogate = fit_field(training)
    z = surrogate.warping.standardise(x)
    feasibility = learn_feasibility(z, ok)
    observation = Observation(interface(np.array([0.2, 0.1])), noise**2)
    likelihood = FieldLikelihood(surrogate, (observation,), TrackedPoints())
    return Knowledge(x, ok, likelihood, feasibility, float(feasibility.log_probability(z).max()))


@dataclass(frozen=True, eq=False)
class Assumed(Knowledge):
    """What runs teach, but for the likelihood: that is a normal one."""

    mean: tuple[float, ...] = (0.2, 0.1)
    sd: float = 0.2

    def plug_in(self, x: np.ndarray) -> np.ndarray:
        return np.asarray(-0.5 * np.sum(((x - np.array(self.mean)) / self.sd) ** 2, axis=1))

    def gain(self, x: np.ndarray, plug_in: np.ndarray) -> np.ndarray:
        return np.zeros(len(x))

    def expected(self, x: np.ndarray, *, plug_in: np.ndarray | None = None) -> np.ndarray:
        return self.plug_in(x)


def own(knowledge: Knowledge) -> dict[str, Any]:
    """Return what a kind of knowledge that assumes a likelihood takes over."""
    return {name: getattr(knowledge, name) for name in ("x", "ok", "likelihood", "feasibility", "highest")}


def state_of(
    knowledge: Knowledge, *, mean: Sequence[float] = (0.2, 0.1), sd: float = 0.2, seed: int = 1, number: int = 600
) -> State:
    """Return a normal posterior, as particles of equal weight inside the box."""
    assumed = Assumed(**own(knowledge), mean=tuple(mean), sd=sd)
    rng = np.random.default_rng(seed)
    x = np.clip(np.array(mean) + sd * rng.standard_normal((number, 2)), -1.0, 1.0)
    equal = np.full(number, -np.log(number))
    values = assumed.plug_in(x)
    return State(assumed, x, equal, equal, equal, values, values)


@dataclass
class FakeLearner:
    """Stands for learning: the posterior's mean after each call, by a list whose last entry goes on for ever."""

    means: Sequence[float] = (0.2,)
    fewest: int = 0
    sd: float = 0.2
    calls: int = field(default=0, init=False)
    first: Knowledge | None = field(default=None, init=False)

    def __call__(self, x: np.ndarray, records: Sequence[RunRecord]) -> Any:
        good = np.array([one.ok for one in records])
        if good.sum() < self.fewest:
            raise TooFewRuns("training", value=str(good.sum()), expected=str(self.fewest), remedy="Add runs.")
        mean = self.means[min(self.calls, len(self.means) - 1)]
        self.calls += 1
        knowledge = replace(self.first or known(x[:12], good[:12]), x=x, ok=good)
        self.first = self.first or knowledge
        return state_of(knowledge, mean=(mean, 0.1), sd=self.sd)
