"""Likelihoods of the observed interfaces: of the model's runs, or of what a surrogate predicts."""

from strandline.likelihood.field import FieldLikelihood, OnHost, noise_length
from strandline.likelihood.interfaces import InterfaceLikelihood
from strandline.likelihood.learnt import evaluated, predicted

__all__ = ["FieldLikelihood", "InterfaceLikelihood", "OnHost", "evaluated", "noise_length", "predicted"]
