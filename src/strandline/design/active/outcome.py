"""What a calibration by a surrogate of the field knows beside its posterior, and what speaks for it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.design.active.active_design import Batch, Step
from strandline.design.active.state import Knowledge
from strandline.posterior.shown import html_table

__all__ = ["Certificate", "FieldOutcome", "VarianceEffect"]


@dataclass(frozen=True, eq=False)
class VarianceEffect:
    """What not knowing the field exactly does to the posterior: with the expected likelihood, against the plug-in one.

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
    """What speaks for the posterior of an active design.

    Args:
        converged: whether it stopped because its tolerances were met.
        reasons: why not, in words.
        steps: the posterior after each batch, the last one that which the result was made from.
        batches: inputs of each batch.
        checked: the step with the last check, or None.
    """

    converged: bool
    reasons: tuple[str, ...]
    steps: tuple[Step, ...]
    batches: tuple[Batch, ...]
    checked: Step | None

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
    """What a calibration by a surrogate of the field knows beside its posterior.

    Args:
        knowledge: Surrogate, likelihood and feasibility.
        effect: Effect of the surrogate's variance on the posterior.
        feasible: Posterior mean of the probability that a run succeeds, relative to the safest one.
        certificate: Certificate of an active design; None for a fixed one.
        compared: Means and standard deviations of the posterior by the log-likelihood surrogate of the same runs.
    """

    knowledge: Knowledge
    effect: VarianceEffect
    feasible: float
    certificate: Certificate | None = None
    compared: Mapping[str, Float[np.ndarray, " dim"]] | None = None
