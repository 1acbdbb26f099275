"""The inputs of a model, known and unknown, and their priors.

In: names, units, fixed values, densities. Out: the space of inputs that designs fill and samplers move in.
"""

from strandline.parameters.fields import COVARIANCES, GaussianField, RandomField, Support
from strandline.parameters.normal_scores import NormalScores
from strandline.parameters.parameter_space import RESERVED, Parameter, ParameterSpace
from strandline.parameters.priors import PRIORS, LogNormal, LogUniform, Normal, Prior, ScaledBeta, Truncated, Uniform

__all__ = [
    "COVARIANCES",
    "GaussianField",
    "LogNormal",
    "LogUniform",
    "Normal",
    "NormalScores",
    "Parameter",
    "ParameterSpace",
    "Prior",
    "RandomField",
    "ScaledBeta",
    "Support",
    "Truncated",
    "Uniform",
]
