"""Squared exponential with a length for each input: exp(-½ Σ_d ((x_d - x'_d) / l_d)²), both radial and a product."""

from strandline.surrogate.kernels.ard import Ard
from strandline.surrogate.kernels.squared_exponential import SQUARED_EXPONENTIAL

__all__ = ["SQUARED_EXPONENTIAL_ARD"]

SQUARED_EXPONENTIAL_ARD = Ard("squared_exponential_ard", SQUARED_EXPONENTIAL)
