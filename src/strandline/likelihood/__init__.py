"""Likelihoods of the observed interfaces: of the model's runs, or of what a surrogate predicts.

In: interfaces, a measure, the noise (stated or unknown). Out: log-likelihoods, exact or by a surrogate, and the
posterior of the noise. It knows no solver.
"""

from strandline.likelihood.field import FieldLikelihood, evaluated, noise_length, predicted, sd_of_distances
from strandline.likelihood.inferred_noise import (
    InferredNoise,
    NoisePosterior,
    infer_noise,
    require_inferable,
    require_inferable_noise,
)
from strandline.likelihood.interfaces import Compared, InterfaceLikelihood, Registered, adapted, compared, with_variance
from strandline.likelihood.local_likelihood import Mixture, Nearby, log_gain
from strandline.likelihood.noise_rule import (
    ResidualNoise,
    StatedErrors,
    differences,
    noise_of_residuals,
    noise_on_surface,
    second_differences,
    stated_errors,
)

__all__ = [
    "Compared",
    "FieldLikelihood",
    "InferredNoise",
    "InterfaceLikelihood",
    "NoisePosterior",
    "compared",
    "evaluated",
    "infer_noise",
    "noise_length",
    "predicted",
    "sd_of_distances",
]
