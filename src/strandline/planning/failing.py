"""How probably a run fails in an experiment not yet made: runs fail where the interface moves too far.

The runs of the present experiment show up to which displacement runs succeed; those that failed count with the
displacement that the surrogate predicts where they were tried.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.design.active import Knowledge
from strandline.errors import InvalidInterface
from strandline.interface import Interface
from strandline.planning.observing import Nodes
from strandline.surrogate.feasibility import Feasibility, learn_feasibility

__all__ = ["FailureBySize", "crossing_share", "learn_failure_by_size"]

MOST_CHECKED = 200
"""Interfaces that are checked for crossing themselves."""


@dataclass(frozen=True, eq=False)
class FailureBySize:
    """The probability that a run fails as a function of the size of the displacement.

    Args:
        undeformed: Undeformed field, shape (value,), mm.
        feasibility: Classifier of success by the standardised logarithm of the size.
        mean: Mean of the logarithms.
        sd: Their standard deviation.
        highest: Largest log probability of success at any run; random failures say nothing about the size.
        largest: Size of the largest displacement of a run that succeeded, mm.
    """

    undeformed: Float[np.ndarray, " value"]
    feasibility: Feasibility
    mean: float
    sd: float
    highest: float
    largest: float

    def failing(self, fields: Float[np.ndarray, "draw value"]) -> Float[np.ndarray, " draw"]:
        """Return the probability that the run of each field fails."""
        z = (np.log(_sizes(fields, self.undeformed)) - self.mean) / self.sd
        return np.asarray(1 - np.exp(np.minimum(self.feasibility.log_probability(z[:, None]) - self.highest, 0.0)))

    def beyond(self, fields: Float[np.ndarray, "draw value"]) -> float:
        """Return the share of fields with a larger displacement than that of any run that succeeded."""
        return float((_sizes(fields, self.undeformed) > self.largest).mean())


def learn_failure_by_size(knowledge: Knowledge, undeformed: Float[np.ndarray, " value"]) -> FailureBySize:
    """Return the probability of failure by the size of the displacement, from the runs of the present experiment.

    Args:
        knowledge: What is known after these runs.
        undeformed: The undeformed interface as a field of the surrogate, mm.
    """
    surrogate = knowledge.surrogate
    sizes = np.log(_sizes(surrogate.modes.fields(surrogate.mean(knowledge.x)), undeformed))
    mean, sd = float(sizes.mean()), float(max(sizes.std(), 1e-12))
    z = ((sizes - mean) / sd)[:, None]
    feasibility = learn_feasibility(z, knowledge.ok)
    highest = float(feasibility.log_probability(z).max())
    return FailureBySize(undeformed, feasibility, mean, sd, highest, float(np.exp(sizes[knowledge.ok].max())))


def _sizes(fields: Float[np.ndarray, "draw value"], undeformed: Float[np.ndarray, " value"]) -> np.ndarray:
    return np.asarray(np.maximum(np.sqrt(np.mean((fields - undeformed) ** 2, axis=1)), 1e-12))


def crossing_share(nodes: Nodes, templates: dict[str, Interface]) -> float:
    """Return the share of predicted polylines that cross or fold onto themselves in some condition.

    Args:
        nodes: Nodes of predicted interfaces by condition, mm.
        templates: An interface of each condition, for its cells.
    """
    number = min(MOST_CHECKED, min(len(one) for one in nodes.values()))
    bad = [any(_crosses(Interface(one[k], templates[name].cells)) for name, one in nodes.items()) for k in range(number)]
    return float(np.mean(bad))


def _crosses(interface: Interface) -> bool:
    if interface.dim == 3:
        return False
    try:
        interface.require_simple()
    except InvalidInterface:
        return True
    return False
