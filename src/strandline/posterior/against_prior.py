"""Do the data contradict the prior of an input?

If prior and model are right, the posterior mean of a normal input is itself a normal draw: its mean is that of the
prior, and its variance the prior's minus the posterior's. Other priors are first mapped to the standard normal one.
"""

from collections.abc import Iterator

import numpy as np
from scipy.special import ndtr, ndtri

from strandline.posterior.posterior import Posterior
from strandline.posterior.weighted import Weighted
from strandline.priors import LogUniform, Uniform

__all__ = ["FLAT", "prior_conflicts"]

FLAT = (Uniform, LogUniform)
"""Priors that say no more than where their ends are; a posterior at an end has a warning of its own."""
LEVEL = 0.01
"""Probability, if prior and model are right, below which there is a warning: one false alarm in 100 inputs."""
LEAST_REMOVED = 0.05
"""Least share of the prior's variance that is taken to be removed: less is within the error of the draws."""
EDGE = 1e-12
"""Keeps normal quantiles finite."""


def prior_conflicts(posterior: Posterior) -> Iterator[str]:
    """Yield a warning for each input whose prior the data contradict, unless that prior is flat."""
    shares = np.clip(posterior.space.prior_shares(posterior.draws), EDGE, 1 - EDGE)
    normal = Weighted(ndtri(shares), posterior.weights)
    z = normal.mean / np.sqrt(np.maximum(1 - normal.sd**2, LEAST_REMOVED))
    for k, one in enumerate(posterior.space):
        p = float(2 * ndtr(-abs(z[k])))
        if p < LEVEL and not isinstance(one.prior, FLAT):
            unit = "" if one.unit in ("", "1") else f" {one.unit}"
            yield (
                f"The data contradict the prior of {one.name}, {one.prior}: a right prior and a right model would put "
                f"the posterior, {posterior.mean[k]:.4g} ± {posterior.sd[k]:.2g}{unit}, as far out with probability "
                f"{p:.1g} only. It is a compromise of both; check the prior, its unit, and the model."
            )
