"""Likelihoods of the observed interfaces: of the model's runs, or of what a surrogate predicts."""

from strandline.likelihood.field import FieldLikelihood, OnHost, noise_length
from strandline.likelihood.interfaces import InterfaceLikelihood

__all__ = ["FieldLikelihood", "InterfaceLikelihood", "OnHost", "noise_length"]
