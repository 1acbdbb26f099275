"""Is the surrogate of the interface good enough for the posterior of one specimen?

Let e be the error of the predicted modes near the posterior, with variances V. It multiplies the likelihood by
exp(∂log L/∂c·e). If it is small and changes little over the posterior, the mean of input d thus moves by
cov(x_d, ∂log L/∂c)·e. The standard deviation of this shift, in posterior standard deviations, is the error that
counts. V is enlarged if the runs nearest to the posterior, each predicted from all others, have larger errors than
expected.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from strandline.likelihood import FieldLikelihood
from strandline.questions.start import Start
from strandline.surrogate.field import FieldSurrogate

__all__ = ["TOLERATED_SHIFT", "Certified", "certify"]

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
