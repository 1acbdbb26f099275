"""The log-likelihood that a surrogate predicts, in the forms that the sampler and the figures need."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from strandline.likelihood.field import OnHost
from strandline.smc import BatchedLogDensity, is_on_host
from strandline.surrogate import GaussianProcess, Predictor, batched_mean

__all__ = ["evaluated", "predicted"]


def predicted(process: Predictor, *, power: float = 1.0) -> BatchedLogDensity:
    """Return `power` times the mean, for the sampler: with JAX if it is a Gaussian process, else for NumPy arrays."""
    if not isinstance(process, GaussianProcess):
        return OnHost(lambda x: power * np.asarray(process.mean(x), float))
    mean = batched_mean(process)
    return mean if power == 1.0 else lambda x: power * mean(x)


def evaluated(log_density: BatchedLogDensity) -> Callable[[Float[np.ndarray, "point dim"]], Any]:
    """Return the same for NumPy arrays, compiled if possible."""
    function: Callable[..., Any] = log_density if is_on_host(log_density) else jax.jit(log_density)
    return function
