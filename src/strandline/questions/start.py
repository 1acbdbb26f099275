"""What the analyses of all specimens share: the surrogate of the interface, and whether it is good enough for one.

Let e be the error of the predicted modes near the posterior, with variances V. It multiplies the likelihood by
exp(∂log L/∂c·e). If it is small and changes little over the posterior, the mean of input d thus moves by
cov(x_d, ∂log L/∂c)·e. The standard deviation of this shift, in posterior standard deviations, is the error that
counts. V is enlarged if the runs nearest to the posterior, each predicted from all others, have larger errors than
expected.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Float, Int

from strandline.design import sobol
from strandline.design.active import Knowledge
from strandline.errors import InvalidInput
from strandline.likelihood import FieldLikelihood
from strandline.parameters import ParameterSpace
from strandline.surrogate.field import FieldPrediction, FieldSurrogate

DRAWS, MANY_INPUTS_DRAWS = 1024, 4096
"""Draws of the prior for up to three unknown inputs and for more."""
FEW_INPUTS = 3
SCRAMBLE = 0
"""Seed that scrambles their Sobol sequence."""


@dataclass(frozen=True, eq=False)
class Start:
    """The surrogate of the interface with draws of the prior, whose predicted interfaces are kept, for the inputs of a
    study of which some are `given`: known for a specimen.
    """

    knowledge: Knowledge
    space: ParameterSpace
    given: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def columns(self) -> Int[np.ndarray, " unknown"]:
        return np.array([i for i, name in enumerate(self.space.names) if name not in self.given])

    @cached_property
    def unknown(self) -> ParameterSpace:
        return ParameterSpace(tuple(self.space.parameters[i] for i in self.columns))

    @cached_property
    def points(self) -> Float[np.ndarray, "draw unknown"]:
        number = DRAWS if self.unknown.dim <= FEW_INPUTS else MANY_INPUTS_DRAWS
        return self.unknown.prior_quantiles(sobol(number, self.unknown.dim, scramble=SCRAMBLE))

    @cached_property
    def predicted(self) -> FieldPrediction:
        return self.predict(self.points)

    @cached_property
    def log_densities(self) -> Float[np.ndarray, " draw"]:
        """Log prior density of these draws, as far as runs succeed there."""
        return self.log_density(self.points)

    def whole(self, x: Float[np.ndarray, "point unknown"]) -> Float[np.ndarray, "point dim"]:
        """Return the values of all inputs, for values of the unknown ones."""
        out = np.tile([self.given.get(name, 0.0) for name in self.space.names], (len(x), 1))
        out[:, self.columns] = x
        return out

    def predict(self, x: Float[np.ndarray, "point unknown"]) -> FieldPrediction:
        return self.knowledge.surrogate.predict(self.whole(x))

    def mean(self, x: Float[np.ndarray, "point unknown"]) -> Float[np.ndarray, "point mode"]:
        return self.knowledge.surrogate.mean(self.whole(x))

    def log_density(self, x: Float[np.ndarray, "point unknown"]) -> Float[np.ndarray, " point"]:
        """Return the log prior density of unknown inputs plus the log probability that a run succeeds there."""
        return np.asarray(self.unknown.log_prior(x) + self.knowledge.log_feasibility(self.whole(x)))

    def with_given(self, given: Mapping[str, float]) -> "Start":
        """Return the start of a specimen with other known inputs, inside their boxes; at least one is unknown."""
        if dict(given) == dict(self.given):
            return self
        for name, value in given.items():
            low, high = self.space[name].interval
            if not low <= value <= high:
                raise InvalidInput(
                    f"known value of {name}",
                    value=value,
                    expected=f"a number from {low:g} to {high:g}, where the runs were made",
                    remedy="Correct it, or widen the prior of this input in study.yaml and run the study again.",
                )
        if len(given) == self.space.dim:
            what, expected = "known inputs of a specimen", "at least one input left to infer"
            raise InvalidInput(what, value=", ".join(given), expected=expected, remedy="Remove a column of the table.")
        return replace(self, given=dict(given))


TOLERATED_SHIFT = 0.1
"""Shift of a posterior mean that is tolerated, in posterior standard deviations."""
NEAREST = 3
"""Number of left-out runs near the posterior that are considered, per number of inputs + 1."""
PRIOR_RUNS = 2.0
"""Runs with errors as expected that count beside them."""


@dataclass(frozen=True)
class Certified:
    """What the surrogate's error may do to a posterior.

    `shift` is the standard deviation of the shift of a posterior mean, in posterior standard deviations, the largest of
    all inputs; `surprise` the root mean square error of the nearest left-out runs over the expected one, at least 1.
    """

    shift: float
    surprise: float

    @property
    def good(self) -> bool:
        return self.shift <= TOLERATED_SHIFT

    @property
    def verdict(self) -> str:
        return "good" if self.good else "refine"


def certify(begin: Start, likelihood: FieldLikelihood, draws: Float[np.ndarray, "draw unknown"]) -> Certified:
    """Return what the error of the surrogate may do to a posterior of which these are equally weighted draws."""
    predicted = begin.predict(draws)
    slopes = likelihood.parabola.parabolas(predicted.mean).slopes
    off, sds = draws - draws.mean(axis=0), np.maximum(draws.std(axis=0), 1e-300)
    moved = (off / sds).T @ (slopes - slopes.mean(axis=0)) / len(draws)
    surprise = _surprise(begin.knowledge.surrogate, begin.whole(draws))
    shift = surprise * np.sqrt(moved**2 @ predicted.variance.mean(axis=0))
    return Certified(float(shift.max()), surprise)


def _surprise(surrogate: FieldSurrogate, x: Float[np.ndarray, "draw dim"]) -> float:
    """Return how much larger than expected the errors at the nearest left-out runs are."""
    z, ratios = _left_out(surrogate)
    middle = surrogate.warping.standardise(x).mean(axis=0)
    nearest = np.argsort(((z - middle) ** 2).sum(axis=1), kind="stable")[: NEAREST * (z.shape[1] + 1)]
    squares = float(ratios[nearest].sum()) + PRIOR_RUNS
    return float(np.sqrt(max(squares / (len(nearest) + PRIOR_RUNS), 1.0)))


@lru_cache(maxsize=2)
def _left_out(surrogate: FieldSurrogate) -> tuple[Float[np.ndarray, "run dim"], Float[np.ndarray, " run"]]:
    """Return the inputs of all runs, and their squared errors when left out over the expected ones."""
    left_out = [process.left_out() for process in surrogate.processes]
    found = sum(one.errors**2 for one in left_out)
    expected = sum(one.variances for one in left_out)
    return surrogate.processes[0].observed.z, np.asarray(found / np.maximum(expected, 1e-300))
