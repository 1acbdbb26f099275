"""How likely a run is to fail in an experiment that has not been made: runs fail where the interface moves too far.

The runs of the present experiment and of other candidates show up to which displacement runs succeed. Failed runs count
with the displacement that the surrogate predicts at their inputs.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import minimize
from scipy.special import expit, log_expit, logit

from strandline.errors import InvalidInterface
from strandline.interface import Interface
from strandline.planning.observing import Nodes
from strandline.surrogate.field import FieldSurrogate

__all__ = ["FailureBySize", "crossing_share", "learn_failure_by_size"]

SLOPE_SD, OFFSET_SD = 50.0, 50.0
"""Standard deviations of the prior of the logistic function's slope and offset."""
PRIOR_RUNS, RARE = 2.0, 0.05
"""Runs that the base rate of failures begins with, and the share of these that fail."""
MOST_CHECKED = 200
"""Interfaces that are checked for crossing themselves."""


@dataclass(frozen=True, eq=False)
class FailureBySize:
    """The probability that a run fails, a logistic function of the log displacement that never decreases.

    Args:
        undeformed: Undeformed field, shape (value,), mm.
        middle: Mean logarithm of the displacement of the runs it was learnt from.
        slope: Derivative of the logit in the logarithm of the displacement, 0 or above.
        offset: Logit there.
    """

    undeformed: Float[np.ndarray, " value"]
    middle: float
    slope: float
    offset: float

    def failing(self, fields: Float[np.ndarray, "draw value"]) -> Float[np.ndarray, " draw"]:
        """Return the probability that the run of each field fails."""
        logs = np.log(_sizes(fields, self.undeformed))
        return np.asarray(expit(self.offset + self.slope * (logs - self.middle)))


def learn_failure_by_size(
    surrogate: FieldSurrogate,
    x: Float[np.ndarray, "run dim"],
    ok: Bool[np.ndarray, " run"],
    undeformed: Float[np.ndarray, " value"],
    others: Float[np.ndarray, "other value"],
) -> FailureBySize:
    """Return the probability of failure by the size of the displacement, from the runs at hand.

    It maximises the likelihood, with a weak normal prior so that a maximum exists even without failures.

    Args:
        surrogate: Surrogate of the interface.
        x: Inputs of all runs.
        ok: Whether each run succeeded.
        undeformed: The undeformed interface as a field of the surrogate, mm.
        others: Fields of further runs that succeeded, in other experiments, mm.
    """
    fields = np.vstack([surrogate.modes.fields(surrogate.mean(x)), others])
    ok = np.concatenate([ok, np.ones(len(others), bool)])
    logs = np.log(_sizes(fields, undeformed))
    middle, sign = float(logs.mean()), np.where(ok, -1.0, 1.0)
    base = float(logit((np.sum(~ok) + PRIOR_RUNS * RARE) / (len(ok) + PRIOR_RUNS)))

    def loss(a: Float[np.ndarray, "2"]) -> float:
        fits = log_expit(sign * (a[0] + a[1] * (logs - middle))).sum()
        return float(-fits + 0.5 * ((a[0] - base) / OFFSET_SD) ** 2 + 0.5 * (a[1] / SLOPE_SD) ** 2)

    found = minimize(loss, [base, 1.0], bounds=[(-300.0, 300.0), (0.0, 300.0)])
    return FailureBySize(undeformed, middle, float(found.x[1]), float(found.x[0]))


def _sizes(fields: Float[np.ndarray, "draw value"], undeformed: Float[np.ndarray, " value"]) -> np.ndarray:
    return np.asarray(np.maximum(np.sqrt(np.mean((fields - undeformed) ** 2, axis=1)), 1e-12))


def crossing_share(nodes: Nodes, templates: dict[str, Interface]) -> float:
    """Return the share of predicted polylines that cross or fold onto themselves in some condition.

    Args:
        nodes: Nodes of predicted interfaces by condition, mm.
        templates: An interface of each condition, for its cells.
    """
    number = min(MOST_CHECKED, min(len(one) for one in nodes.values()))
    bad = [
        any(_crosses(Interface(one[k], templates[name].cells)) for name, one in nodes.items()) for k in range(number)
    ]
    return float(np.mean(bad))


def _crosses(interface: Interface) -> bool:
    if interface.dim == 3:
        return False
    try:
        interface.require_simple()
    except InvalidInterface:
        return True
    return False
