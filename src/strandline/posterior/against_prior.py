"""Do the data contradict the prior of an input?

If prior and model are right, the posterior mean of a normal input is itself a normal draw: its mean is that of the
prior, and its variance the prior's minus the posterior's. Other priors are first mapped to the standard normal one.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from strandline.parameters import Parameter
from strandline.posterior.posterior import Posterior
from strandline.posterior.weighted import Weighted
from strandline.priors import LogUniform, Uniform

__all__ = ["FLAT", "PriorConflict", "prior_conflicts"]

FLAT = (Uniform, LogUniform)
"""Priors that say no more than where their ends are; a posterior at an end is told otherwise."""
LEVEL = 0.01
"""Probability of a posterior as far from a right prior, below which it is told: one false alarm in 100 inputs."""
TOLD = 0.05
"""Least share of the prior's variance that is taken to be removed: less is within the error of the draws."""
EDGE = 1e-12
"""Keeps normal quantiles finite."""


@dataclass(frozen=True)
class PriorConflict:
    """An input whose prior the data contradict.

    Args:
        parameter: The input.
        mean: Its posterior mean.
        sd: Its posterior standard deviation.
        p: Probability of a posterior mean as far from the prior, if prior and model are right.
    """

    parameter: Parameter
    mean: float
    sd: float
    p: float

    def __str__(self) -> str:
        unit = "" if self.parameter.unit in ("", "1") else f" {self.parameter.unit}"
        return (
            f"The data contradict the prior of {self.parameter.name}, {self.parameter.prior}: the posterior, "
            f"{self.mean:.4g} ± {self.sd:.2g}{unit}, lies where a right prior and a right model would put it with "
            f"probability {self.p:.1g} only. It is a compromise of both; check the prior, its unit, and the model."
        )


def prior_conflicts(posterior: Posterior) -> Iterator[PriorConflict]:
    """Yield the inputs whose prior the data contradict, those with flat priors excepted."""
    shares = np.clip(posterior.space.prior_shares(posterior.draws), EDGE, 1 - EDGE)
    normal = Weighted(ndtri(shares), posterior.weights)
    z = normal.mean / np.sqrt(np.maximum(1 - normal.sd**2, TOLD))
    for k, parameter in enumerate(posterior.space):
        p = float(2 * ndtr(-abs(z[k])))
        if p < LEVEL and not isinstance(parameter.prior, FLAT):
            yield PriorConflict(parameter, float(posterior.mean[k]), float(posterior.sd[k]), p)
