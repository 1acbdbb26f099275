"""A bent line with two inputs, its surrogate, and posteriors of known moments: shared by tests of active designs."""

from dataclasses import dataclass, fields, replace
from functools import lru_cache

import numpy as np

import strandline as sl
from strandline.design.active.checking import LogRatios
from strandline.design.active.posterior_check import PosteriorChecker
from strandline.design.active.state import Knowledge, State
from strandline.foundations import TooFewRuns
from strandline.likelihood import FieldLikelihood
from strandline.surrogate.feasibility import learn_feasibility
from strandline.surrogate.field import FieldTraining, fit_field

SPACE = sl.ParameterSpace((sl.Parameter("a", sl.Uniform(-1.0, 1.0)), sl.Parameter("b", sl.Uniform(-1.0, 1.0))))
S = np.linspace(0.0, 1.0, 9)
NOISE = 0.02
MEAN = np.array([0.2, 0.1])


def even(number, scramble=None):
    """Return points of the Sobol sequence."""
    return SPACE.to_physical(sl.sobol(number, 2, scramble=scramble))


def interface(x):
    """Return a line that is bent by the first input and lifted by the second."""
    y = 0.1 * (x[0] * S + np.sin(2 * x[0] + x[1]) * S**2 + 0.5 * x[1])
    return sl.Interface.polyline(np.stack([S, y], axis=1))


def record(x, *, ok=True):
    found = {"": interface(x)} if ok else {}
    return sl.RunRecord(x.tobytes().hex(), SPACE.as_mapping(x), "ok" if ok else "failed", found)


def inputs_of(one):
    return np.array([one.inputs["a"], one.inputs["b"]])


def normal(x, mean=MEAN, sd=0.2):
    """Return the log-density of a normal posterior, but for a constant."""
    return -0.5 * np.sum(((x - np.array(mean)) / sd) ** 2, axis=-1)


def training(x, interfaces):
    return FieldTraining(x, interfaces, None, SPACE.low, SPACE.high)


def known(x, ok=None, *, noise=NOISE):
    """Return what runs at `x` teach."""
    ok = np.ones(len(x), bool) if ok is None else ok
    return _known(x.astype(float).tobytes(), ok.tobytes(), noise)


@lru_cache
def _known(inputs, outcomes, noise):
    x, ok = np.frombuffer(inputs).reshape(-1, 2), np.frombuffer(outcomes, bool)
    surrogate = fit_field(training(x[ok], [{"": interface(row)} for row in x[ok]]))
    z = surrogate.warping.standardise(x)
    feasibility = learn_feasibility(z, ok)
    likelihood = FieldLikelihood(surrogate, (sl.Observation(interface(MEAN), noise**2),), sl.TrackedPoints())
    return Knowledge(x, ok, likelihood, feasibility, float(feasibility.log_probability(z).max()))


@dataclass(frozen=True, eq=False)
class Assumed(Knowledge):
    """What runs teach, but for the likelihood: that is a normal one, to which the uncertainty adds `doubt`."""

    mean: tuple[float, ...] = (0.2, 0.1)
    sd: float = 0.2
    doubt: float = 0.0

    def plug_in(self, x):
        return normal(x, self.mean, self.sd)

    def gain(self, x, plug_in):
        return np.zeros(len(x))

    def expected(self, x, *, plug_in=None):
        return self.plug_in(x) + self.doubt


def own(knowledge):
    """Return what a kind of knowledge that assumes a likelihood takes over."""
    return {each.name: getattr(knowledge, each.name) for each in fields(Knowledge)}


def state_of(knowledge, *, mean=MEAN, sd=0.2, seed=1, number=600):
    """Return a normal posterior, as particles of equal weight inside the box."""
    assumed = Assumed(**own(knowledge), mean=tuple(mean), sd=sd)
    x = np.clip(np.array(mean) + sd * np.random.default_rng(seed).standard_normal((number, 2)), -1.0, 1.0)
    equal, values = np.full(number, -np.log(number)), assumed.plug_in(x)
    return State(assumed, x, equal, equal, equal, values, values)


@dataclass
class FakeLearner:
    """Stands for learning: the posterior's mean after each call, by a list whose last entry goes on for ever."""

    means: tuple[float, ...] = (0.2,)
    fewest: int = 0
    calls: int = 0
    first: Knowledge | None = None

    def __call__(self, x, records):
        good = np.array([one.ok for one in records])
        if good.sum() < self.fewest:
            raise TooFewRuns("training", value=str(good.sum()), expected=str(self.fewest), remedy="Add runs.")
        mean = self.means[min(self.calls, len(self.means) - 1)]
        self.calls += 1
        self.first = self.first or known(x[:12], good[:12])
        return state_of(replace(self.first, x=x, ok=good), mean=(mean, 0.1))


class Trusting(PosteriorChecker):
    """`FakeLearner` has a surrogate of its first runs only, which cannot be left out one by one."""

    odd = ()
    chosen = None

    def left_out(self, state, looked_around, chosen):
        self.chosen, (found, self.odd) = chosen, (self.odd, ())
        return found

    def unknown(self, state, most):
        return np.empty((0, 2))

    def near(self, state, records):
        """Leaving out a draw of the check changes nothing."""
        drawn = [] if self._checked is None else [row.tobytes().hex() for row in self._checked.drawn]
        made = [one for one in records if one.ok and one.key in drawn]
        x = np.array([inputs_of(one) for one in made]).reshape(-1, 2)
        true = np.array([self.log_likelihood(one) for one in made])
        return LogRatios(x, true - state.knowledge.expected(x), np.zeros(len(x)))


def honest(one):
    """Return the log-likelihood by which `FakeLearner` weighs its particles, of mean 0.2."""
    return float(normal(inputs_of(one)))


def kinds(batches):
    return [batch.kind for batch in batches]
