"""Gaussian-process surrogates.

In: inputs, and log-likelihoods or whole interfaces of runs. Out: a mean and a variance at further inputs, with
derivatives. It knows neither simulators nor files.
"""

from strandline.surrogate.feasibility import Feasibility, learn_feasibility
from strandline.surrogate.field import MANY_INPUTS, FieldPrediction, FieldSurrogate, FieldTraining, fit_field
from strandline.surrogate.field.correction import FEWEST_PAIRS, Correction, fit_correction
from strandline.surrogate.field.correspondence import fields_of, flipped, odd_ones, stopped_early
from strandline.surrogate.gaussian_process import GaussianProcess, batched_mean, condition
from strandline.surrogate.hyperparameters import (
    EvidenceSearch,
    FittedHyperparameters,
    LogEvidence,
    evidence,
    fit_hyperparameters,
)
from strandline.surrogate.kernels import KERNELS, Kernel, LengthScale, kernel_named
from strandline.surrogate.log_likelihood import (
    Fit,
    HasHessian,
    LogLikelihoodSurrogate,
    Predictor,
    Validation,
    fit_log_likelihood,
    fit_named,
    fit_of_the_user,
    validate,
)

__all__ = [
    "KERNELS",
    "EvidenceSearch",
    "Fit",
    "FittedHyperparameters",
    "GaussianProcess",
    "HasHessian",
    "Kernel",
    "LengthScale",
    "LogEvidence",
    "LogLikelihoodSurrogate",
    "Predictor",
    "Validation",
    "batched_mean",
    "condition",
    "evidence",
    "fit_hyperparameters",
    "fit_log_likelihood",
    "fit_named",
    "fit_of_the_user",
    "validate",
]
