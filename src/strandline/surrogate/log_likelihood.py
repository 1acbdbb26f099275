"""Surrogates of the log-likelihood over the physical inputs: the study's Gaussian process, or the user's own."""

from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float

from strandline.errors import InvalidInput
from strandline.surrogate.gaussian_process import condition, standardisation
from strandline.surrogate.hyperparameters import FittedHyperparameters, fit_hyperparameters, require_runs
from strandline.surrogate.kernels import kernel_named
from strandline.surrogate.predictor import Fit, Predictor
from strandline.surrogate.validation import Validation, cross_validate, validate

__all__ = ["NUGGET_SHARE", "LogLikelihoodSurrogate", "fit_log_likelihood", "fit_of_the_user"]

NUGGET_SHARE = 1e-5


@dataclass(frozen=True, eq=False)
class LogLikelihoodSurrogate:
    """A surrogate of the log-likelihood and how well it predicts runs that it has not seen.

    Args:
        process: The surrogate.
        validation: Errors of runs that were left out.
        fit: How the hyperparameters of the Gaussian process were found; None for the user's own surrogate.
    """

    process: Predictor
    validation: Validation
    fit: FittedHyperparameters | None

    @property
    def left_out(self) -> str:
        """What the validation leaves out: ``leave-one-out``, or ``leave-a-tenth-out`` for the user's own surrogate."""
        return "leave-a-tenth-out" if self.fit is None else "leave-one-out"


def fit_log_likelihood(
    x: Float[np.ndarray, "run dim"], log_likelihood: Float[np.ndarray, " target"], *, kernel: str = "matern32"
) -> LogLikelihoodSurrogate:
    """Fit the surrogate of Willmann et al. (2022): nugget σ_n² = 1e-5 (max 𝓛 - min 𝓛).

    Args:
        x: physical inputs of the successful runs.
        log_likelihood: their log-likelihoods.
        kernel: Name in `KERNELS`, or ``module:name``; the publication uses ``matern32`` for its homogeneous specimen,
            ``matern32_product`` for the one with three parts.

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


def fit_of_the_user(
    x: Float[np.ndarray, "run dim"], log_likelihood: Float[np.ndarray, " target"], fit: Fit
) -> LogLikelihoodSurrogate:
    """Return a surrogate learnt by the user's function, validated by leaving out a tenth of the runs at a time.

    Args:
        x: physical inputs of the successful runs.
        log_likelihood: their log-likelihoods.
        fit: The user's function.

    Raises:
        TooFewRuns: fewer than dim + 2 runs.
        InvalidInput: values that are not finite, or the function returns something that is not a surrogate.
    """
    _require_one_each(x, log_likelihood)
    require_runs(x, log_likelihood)
    learn = partial(_learnt, fit)
    return LogLikelihoodSurrogate(learn(x, log_likelihood), cross_validate(learn, x, log_likelihood), None)


def _learnt(fit: Fit, x: Float[np.ndarray, "run dim"], y: Float[np.ndarray, " run"]) -> Predictor:
    found = fit(x, y)
    if not isinstance(found, Predictor):
        raise InvalidInput(
            "what the surrogate's function returns",
            value=type(found).__name__,
            expected="an object with the methods mean and variance",
            remedy="Check it with strandline.testing.surrogates.",
        )
    return found


def _require_one_each(x: Float[np.ndarray, "run dim"], y: Float[np.ndarray, " other"]) -> None:
    if len(x) != len(y):
        raise InvalidInput(
            "training data of the surrogate",
            value=f"{len(x)} inputs and {len(y)} log-likelihoods",
            expected="one log-likelihood for each run",
            remedy="Pass the successful runs only, in the same order.",
        )
