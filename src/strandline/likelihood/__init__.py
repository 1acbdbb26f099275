"""Likelihoods of the observed interfaces: of the model's runs, or of what a surrogate predicts."""

from strandline.likelihood.compared import Compared, compared, errors_of
from strandline.likelihood.field import FieldLikelihood, OnHost, noise_length, sd_of_distances
from strandline.likelihood.inferred_noise import InferredNoise, NoisePosterior, infer_noise
from strandline.likelihood.interfaces import InterfaceLikelihood
from strandline.likelihood.learnt import evaluated, predicted

__all__ = [
    "Compared",
    "FieldLikelihood",
    "InferredNoise",
    "InterfaceLikelihood",
    "NoisePosterior",
    "OnHost",
    "compared",
    "errors_of",
    "evaluated",
    "infer_noise",
    "noise_length",
    "predicted",
    "sd_of_distances",
]
