"""The study's surrogate: a Gaussian process of the log-likelihood over the physical inputs."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.errors import InvalidInput
from strandline.surrogate.gaussian_process import GaussianProcess, condition, standardisation
from strandline.surrogate.hyperparameters import FittedHyperparameters, fit_hyperparameters, require_runs
from strandline.surrogate.kernels import kernel_named
from strandline.surrogate.validation import Validation, validate

__all__ = ["NUGGET_SHARE", "LogLikelihoodSurrogate", "fit_log_likelihood"]

NUGGET_SHARE = 1e-5


@dataclass(frozen=True, eq=False)
class LogLikelihoodSurrogate:
    """A Gaussian process of the log-likelihood, its validation and how its hyperparameters were found."""

    process: GaussianProcess
    validation: Validation
    fit: FittedHyperparameters


def fit_log_likelihood(
    x: Float[np.ndarray, "run dim"], log_likelihood: Float[np.ndarray, " target"], *, kernel: str = "matern32"
) -> LogLikelihoodSurrogate:
    """Fit the surrogate of Willmann et al. (2022): nugget σ_n² = 1e-5 (max 𝓛 - min 𝓛).

    Args:
        x: physical inputs of the successful runs.
        log_likelihood: their log-likelihoods.
        kernel: Name in `KERNELS`, or ``module:name``; the publication has ``matern32`` for its homogeneous specimen and
            ``matern32_product`` for that of three parts.

    Raises:
        TooFewRuns: fewer than dim + 2 runs.
        InvalidInput: values that are not finite, an input that does not vary, or an unknown kernel.
        NumericsError: constant log-likelihoods, or hyperparameters that could not be found.
    """
    _require_one_each(x, log_likelihood)
    require_runs(x, log_likelihood)
    correlation = kernel_named(kernel)
    shift, scale = standardisation(x)
    nugget = NUGGET_SHARE * float(np.ptp(log_likelihood))
    centred = log_likelihood - log_likelihood.mean()
    fit = fit_hyperparameters((x - shift) / scale, centred, kernel=correlation, nugget=nugget)
    process = condition(
        x,
        log_likelihood,
        kernel=correlation,
        length_scale=fit.length_scale,
        signal_variance=fit.signal_variance,
        nugget=nugget,
    )
    return LogLikelihoodSurrogate(process, validate(process, log_likelihood), fit)


def _require_one_each(x: Float[np.ndarray, "run dim"], y: Float[np.ndarray, " other"]) -> None:
    if len(x) != len(y):
        raise InvalidInput(
            "training data of the surrogate",
            value=f"{len(x)} inputs and {len(y)} log-likelihoods",
            expected="one log-likelihood for each run",
            remedy="Pass the successful runs only, in the same order.",
        )
