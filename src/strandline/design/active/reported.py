"""One-line report on a batch of an active design."""

from dataclasses import dataclass
from typing import Literal

from strandline.design.active.active_design import ActiveDesign, Step
from strandline.parameters import ParameterSpace
from strandline.text import with_sd

__all__ = ["BatchReport", "report_batch"]

Next = Literal["batch", "check", "done", "stop"]
NEXT = {"batch": "a batch", "check": "check", "done": "done, converged", "stop": "stop, not converged"}
SHOWN = 3
"""Inputs whose mean and standard deviation a line has room for."""


@dataclass(frozen=True)
class BatchReport:
    """The posterior after a batch, and what comes next.

    Args:
        number: number of the batch; the first design is 1.
        posterior: mean and standard deviation of each calibrated input by its symbol, as text.
        moved: how far the posterior has moved, in standard deviations; None if there is none to compare with.
        next: what the design does next.
        objection: what a check objected to, in words; empty if there was none.
    """

    number: int
    posterior: tuple[str, ...]
    moved: float | None
    next: Next
    objection: str = ""

    @property
    def line(self) -> str:
        """``batch 3: E 396 ± 31, moved 0.05 sd; next: check``."""
        shown = ", ".join(self.posterior[:SHOWN]) + (", …" if len(self.posterior) > SHOWN else "")
        moved = "" if self.moved is None else f", moved {self.moved:.2f} sd"
        objection = f"; check: {self.objection}" if self.objection else ""
        return f"batch {self.number}: {shown}{moved}{objection}; next: {NEXT[self.next]}"


def report_batch(design: ActiveDesign, space: ParameterSpace) -> BatchReport:
    """Return the report on the last step of `design`, which has decided what comes next."""
    step: Step = design.steps[-1]
    after = not design.converged and not design.reasons
    coming: Next = "done" if design.converged else "stop"
    if after:
        coming = "check" if design.batches[-1].kind == "check" else "batch"
    posterior = tuple(
        f"{space.parameters[i].shown} {with_sd(float(step.mean[i]), float(step.sd[i]))}" for i in space.calibrated
    )
    objection = "" if step.check is None or not step.check.reasons else step.check.reasons[0]
    moved = None if step.moved is None else step.moved.shift
    return BatchReport(len(design.steps), posterior, moved, coming, objection)
