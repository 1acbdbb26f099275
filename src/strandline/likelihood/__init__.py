"""Likelihoods of the observed interfaces: of the model's runs, or of what a surrogate predicts."""

from strandline.likelihood.compared import Compared, compared
from strandline.likelihood.field import FieldLikelihood, evaluated, noise_length, predicted, sd_of_distances
from strandline.likelihood.inferred_noise import InferredNoise, NoisePosterior, infer_noise
from strandline.likelihood.interfaces import InterfaceLikelihood

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
