"""One-line report on a batch of an active design."""

import math
from dataclasses import dataclass
from typing import Literal

from strandline.design.active.active_design import ActiveDesign, Step
from strandline.parameters import ParameterSpace
from strandline.text import with_sd

__all__ = ["BatchReport", "report_batch"]

Next = Literal["batch", "check", "trial", "done", "stop"]
NEXT = {
    "batch": "a batch",
    "check": "check",
    "trial": "the correction is tried again",
    "done": "done, converged",
    "stop": "stop, not converged",
}
FAR = 0.5
"""Share of draws still effective below which a posterior has moved too far to say by how much."""
SHOWN = 3
"""Inputs whose mean and standard deviation a line has room for."""


@dataclass(frozen=True)
class BatchReport:
    """The posterior after a batch, and what comes next.

    Args:
        number: number of the batch; the first design is 1.
        posterior: mean and standard deviation of each calibrated input by its symbol, as text.
        moved: how far the posterior has moved, in standard deviations: infinite if it is too far to say; None if there
            is none to compare with.
        next: what the design does next.
        objection: what a check objected to, in words; empty if there was none.
        dropped: why a cheaper model is not used any more, in words; empty if it is, or if this was told before.
    """

    number: int
    posterior: tuple[str, ...]
    moved: float | None
    next: Next
    objection: str = ""
    dropped: str = ""

    @property
    def line(self) -> str:
        """``batch 3: E 396 ± 31, moved 0.05 sd; next: check``."""
        shown = ", ".join(self.posterior[:SHOWN]) + (", …" if len(self.posterior) > SHOWN else "")
        far = self.moved is not None and math.isinf(self.moved)
        moved = "" if self.moved is None else ", moved far" if far else f", moved {self.moved:.2f} sd"
        objection = f"; check: {self.objection}" if self.objection else ""
        dropped = f"; the cheaper model is no longer used: {self.dropped}" if self.dropped else ""
        return f"batch {self.number}: {shown}{moved}{objection}{dropped}; next: {NEXT[self.next]}"


def report_batch(design: ActiveDesign, space: ParameterSpace) -> BatchReport:
    """Return the report on the last step of `design`, which has decided what comes next."""
    step: Step = design.steps[-1]
    after = not design.converged and not design.reasons
    coming: Next = "done" if design.converged else "stop"
    if after:
        kind = design.batches[-1].kind
        coming = kind if kind in ("check", "trial") else "batch"
    posterior = tuple(
        f"{space.parameters[i].shown} {with_sd(float(step.mean[i]), float(step.sd[i]))}" for i in space.calibrated
    )
    objection = "" if step.check is None or not step.check.reasons else step.check.reasons[0]
    moved = None if step.moved is None else step.moved.shift if step.moved.effective >= FAR else math.inf
    return BatchReport(len(design.steps), posterior, moved, coming, objection)
