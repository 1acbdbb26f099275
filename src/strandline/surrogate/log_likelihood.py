"""Surrogates of the log-likelihood over the physical inputs: the study's Gaussian process, or the user's own."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from strandline.foundations import imported, require
from strandline.surrogate.covariance import invert
from strandline.surrogate.gaussian_process import GaussianProcess, Inputs, Targets, condition, standardisation
from strandline.surrogate.hyperparameters import FittedHyperparameters, fit_hyperparameters, require_runs
from strandline.surrogate.kernels import kernel_named

NEAR_MODE_WINDOW = 10.0
NEAR_MODE_COUNT = 10
FOLDS = 10
NUGGET_SHARE = 1e-5
CHECK = "Check it with strandline.testing.surrogates."


@runtime_checkable
class Predictor(Protocol):
    """A function learnt from values at the inputs of runs; a `GaussianProcess` is one.

    All inputs are physical. `HasHessian` describes what else it may offer.
    """

    def mean(self, x: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, " point"]:
        """Return the predicted values."""

    def variance(self, x: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, " point"]:
        """Return the variances of the predicted values, not negative."""


@runtime_checkable
class HasHessian(Protocol):
    """A predictor that knows its second derivatives; for others, central differences are used."""

    def hessian(self, x: Float[np.ndarray, "point dim"]) -> Float[np.ndarray, "point dim dim"]:
        """Return the Hessian of the mean."""


Fit = Callable[[Inputs, Targets], Predictor]
"""A function that learns from inputs (run, dim) and values (run,)."""


def fit_named(name: str) -> Fit:
    """Return the function ``module:name`` that learns a surrogate.

    Raises:
        InvalidInput: There is no such function.
    """
    found: Any = imported(name, "name of the surrogate")
    expected = "a function of inputs (run, dim) and log-likelihoods (run,) that returns a surrogate"
    require(callable(found), "name of the surrogate", name, expected, CHECK)
    return found  # type: ignore[no-any-return]


@dataclass(frozen=True, eq=False)
class Validation:
    """How well each training run is predicted from others that do not include it.

    For a Gaussian process these are all others, with hyperparameters and centring fixed; else nine tenths of the runs.
    Residuals are targets minus predictions. Runs near the mode are those whose target lies within `NEAR_MODE_WINDOW` of
    the largest one, and always the `NEAR_MODE_COUNT` best: errors there affect a posterior.
    """

    residuals: Targets
    near_mode: Bool[np.ndarray, " run"]
    loo_rms: float
    loo_rms_near_mode: float
    near_mode_count: int


def validate(gp: GaussianProcess, y: Targets) -> Validation:
    """Return the leave-one-out residuals r_i = α_i / (K⁻¹)_ii of `gp`, whose training targets were `y`."""
    inverse = gp.cholesky.copy(order="F")
    invert(inverse)
    return _validation(gp.alpha / np.diagonal(inverse), y)


def cross_validate(fit: Callable[[Inputs, Targets], Predictor], x: Inputs, y: Targets) -> Validation:
    """Return the residuals of every tenth run, learnt from the others, for all ten tenths."""
    residuals = np.empty(len(y))
    for k in range(min(FOLDS, len(y))):
        left_out = np.arange(len(y)) % FOLDS == k
        residuals[left_out] = y[left_out] - fit(x[~left_out], y[~left_out]).mean(x[left_out])
    return _validation(residuals, y)


def _validation(residuals: Targets, y: Targets) -> Validation:
    tenth_best = np.sort(y)[-min(NEAR_MODE_COUNT, len(y))]
    near = np.asarray(y >= min(tenth_best, y.max() - NEAR_MODE_WINDOW))
    return Validation(residuals, near, _rms(residuals), _rms(residuals[near]), int(near.sum()))


def _rms(values: Float[np.ndarray, " value"]) -> float:
    return float(np.sqrt(np.mean(values**2)))


@dataclass(frozen=True, eq=False)
class LogLikelihoodSurrogate:
    """A surrogate of the log-likelihood, the errors of runs that were left out, and how the hyperparameters of the
    Gaussian process were found: None for the user's own surrogate.
    """

    process: Predictor
    validation: Validation
    fit: FittedHyperparameters | None

    @property
    def left_out(self) -> str:
        """What the validation leaves out: ``leave-one-out``, or ``leave-a-tenth-out`` for the user's own surrogate."""
        return "leave-a-tenth-out" if self.fit is None else "leave-one-out"


def fit_log_likelihood(
    x: Inputs, log_likelihood: Float[np.ndarray, " target"], *, kernel: str = "matern32"
) -> LogLikelihoodSurrogate:
    """Fit the surrogate of Willmann et al. (2022): nugget σ_n² = 1e-5 (max 𝓛 - min 𝓛).

    Inputs are physical, and those of the successful runs. The kernel is a name in `KERNELS`, or ``module:name``; the
    publication uses ``matern32`` for its homogeneous specimen, ``matern32_product`` for the one with three parts.

    Raises:
        TooFewRuns: fewer than dim + 2 runs.
        InvalidInput: values that are not finite, an input that does not vary, or an unknown kernel.
        NumericsError: constant log-likelihoods, or hyperparameters that could not be found.
    """
    require_runs(x, log_likelihood)
    correlation = kernel_named(kernel)
    shift, scale = standardisation(x)
    nugget = NUGGET_SHARE * float(np.ptp(log_likelihood))
    centred = log_likelihood - log_likelihood.mean()
    fit = fit_hyperparameters((x - shift) / scale, centred, kernel=correlation, nugget=nugget)
    conditioned = partial(condition, x, log_likelihood, kernel=correlation, nugget=nugget)
    process = conditioned(length_scale=fit.length_scale, signal_variance=fit.signal_variance)
    return LogLikelihoodSurrogate(process, validate(process, log_likelihood), fit)


def fit_of_the_user(x: Inputs, log_likelihood: Float[np.ndarray, " target"], fit: Fit) -> LogLikelihoodSurrogate:
    """Return a surrogate learnt by the user's function, validated by leaving out a tenth of the runs at a time.

    Raises:
        TooFewRuns: fewer than dim + 2 runs.
        InvalidInput: values that are not finite, or the function returns something that is not a surrogate.
    """
    require_runs(x, log_likelihood)
    learn = partial(_learnt, fit)
    return LogLikelihoodSurrogate(learn(x, log_likelihood), cross_validate(learn, x, log_likelihood), None)


def _learnt(fit: Fit, x: Inputs, y: Targets) -> Predictor:
    found = fit(x, y)
    words = type(found).__name__, "an object with the methods mean and variance", CHECK
    require(isinstance(found, Predictor), "what the surrogate's function returns", *words)
    return found
