"""Check before the first run that a user's own prior has what a study needs."""

import jax
import numpy as np

from strandline.errors import InvalidStudy
from strandline.priors import Prior
from strandline.studies.chosen import require_parts

__all__ = ["require_prior"]

PARTS = ("support", "log_density", "cdf", "quantile")


def require_prior(prior: Prior, place: str) -> None:
    """Refuse a prior that lacks a part, has no interval as support, or whose density JAX cannot compile.

    Raises:
        InvalidStudy: The prior cannot be used; the conformance suite says more.
    """
    require_parts(prior, PARTS, place)
    support = prior.support
    if not (isinstance(support, tuple) and len(support) == 2 and support[0] < support[1]):
        raise _refused(place, f"the support {support!r}", "a property `support` of two numbers, (low, high)")
    numbers = np.zeros(3, np.float32)
    try:
        shape = jax.eval_shape(prior.log_density, numbers).shape
    except Exception as error:
        raise _refused(
            place, f"a log_density that fails with {type(error).__name__}", "one that works on JAX arrays under jax.jit"
        ) from None
    if shape != (3,):
        raise _refused(place, f"a log_density that turns 3 numbers into the shape {shape}", "a number for each")


def _refused(place: str, value: str, expected: str) -> InvalidStudy:
    return InvalidStudy(place, value=value, expected=expected, remedy="Check the prior with strandline.testing.priors.")
