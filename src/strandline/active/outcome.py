"""What a calibration by a surrogate of the field knows beside its posterior, and what speaks for it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.active.design import Batch, Step
from strandline.active.state import Knowledge

__all__ = ["Certificate", "FieldOutcome", "VarianceEffect"]


@dataclass(frozen=True, eq=False)
class VarianceEffect:
    """What not knowing the field exactly does to the posterior: with the expected likelihood, against the plug-in one.

    Args:
        shift: of the means, in standard deviations (dim,).
        sd_ratio: of the standard deviations (dim,).
        effective: effective sample size of the weights between the two, as a share.
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


@dataclass(frozen=True, eq=False)
class FieldOutcome:
    """What a calibration by a surrogate of the field knows beside its posterior.

    Args:
        knowledge: surrogate, likelihood and feasibility.
        effect: of the surrogate's variance.
        feasible: posterior mean of the probability that a run succeeds, relative to the safest one.
        certificate: of an active design; None for a fixed one.
        compared: means and standard deviations of the posterior by the log-likelihood surrogate of the same runs.
    """

    knowledge: Knowledge
    effect: VarianceEffect
    feasible: float
    certificate: Certificate | None = None
    compared: Mapping[str, Float[np.ndarray, " dim"]] | None = None
