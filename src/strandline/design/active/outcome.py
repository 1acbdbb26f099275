"""Results of a calibration by a surrogate of the field besides the posterior, and grounds for trusting it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.design.active.active_design import Batch, Step
from strandline.design.active.elsewhere import SURE
from strandline.design.active.fidelities import FidelityReport
from strandline.design.active.scatter import NONE, Scatter
from strandline.design.active.state import Knowledge
from strandline.typeset import html_table

__all__ = ["Certificate", "FieldOutcome", "VarianceEffect"]


@dataclass(frozen=True, eq=False)
class VarianceEffect:
    """Effect of the field's uncertainty on the posterior: expected likelihood compared with the plug-in one.

    Args:
        shift: Shift of the posterior means, in standard deviations, shape (dim,).
        sd_ratio: Ratio of the posterior standard deviations, shape (dim,).
        effective: Effective sample size of the weights between the two, as a share.
    """

    shift: Float[np.ndarray, " dim"]
    sd_ratio: Float[np.ndarray, " dim"]
    effective: float


@dataclass(frozen=True, eq=False)
class Certificate:
    """Grounds for trusting the posterior of an active design.

    Args:
        converged: whether it stopped because its tolerances were met.
        reasons: why it did not converge, in words.
        steps: the posterior after each batch; the result is computed from the last one.
        batches: inputs of each batch.
        checked: the step with the last check, or None.
        found: smallest share of the prior's mass such that 95 % of all compact regions with this share hold a run.
        fidelities: What a cheaper model was used for; None if there was none.
        scattered: whether the simulator's own scatter keeps it from converging.
        overlooks: whether the runs were too few to find a region as small as `Active.unseen`.
    """

    converged: bool
    reasons: tuple[str, ...]
    steps: tuple[Step, ...]
    batches: tuple[Batch, ...]
    checked: Step | None
    found: float = 1.0
    fidelities: FidelityReport | None = None
    scattered: bool = False
    overlooks: bool = False

    @property
    def statement(self) -> str:
        """What the runs have seen of the prior, in words."""
        if self.found >= 1:
            return "The runs are too few to say whether another region fits."
        return (
            f"With {SURE:.0%} probability, the runs would have found any other compact region that fits, if it holds "
            f"{self.found:.0%} or more of the prior's mass. A smaller or a narrow one may have been missed."
        )

    def __repr__(self) -> str:
        runs = self.steps[-1].runs if self.steps else 0
        state = "converged" if self.converged else "not converged: " + "; ".join(self.reasons)
        return f"<Certificate after {runs} runs: {state}>"

    def _repr_html_(self) -> str:
        rows = [
            (str(step.runs), step.kind, "" if step.moved is None else f"{step.moved.shift:.2g}") for step in self.steps
        ]
        return html_table(("runs", "batch", "posterior moved by, sd"), rows, caption=repr(self)[1:-1])


@dataclass(frozen=True, eq=False)
class FieldOutcome:
    """Results of a calibration by a surrogate of the field besides the posterior.

    Args:
        knowledge: Surrogate, likelihood and feasibility.
        effect: Effect of the surrogate's variance on the posterior.
        feasible: Posterior mean of the probability that a run succeeds, relative to the safest one.
        certificate: Certificate of an active design; None for a fixed design.
        compared: Means and standard deviations of the posterior from the log-likelihood surrogate of the same runs.
        without_error: The same of the posterior of a model that does not err, if an error was allowed for.
        scatter: The simulator's own scatter, and what it does to the log-likelihood.
    """

    knowledge: Knowledge
    effect: VarianceEffect
    feasible: float
    certificate: Certificate | None = None
    compared: Mapping[str, Float[np.ndarray, " dim"]] | None = None
    without_error: Mapping[str, Float[np.ndarray, " dim"]] | None = None
    scatter: Scatter = NONE
