"""Matérn 3/2 with a length for each input: (1 + √3 s) exp(-√3 s), s² = Σ_d ((x_d - x'_d) / l_d)²."""

from strandline.surrogate.kernels.ard import Ard
from strandline.surrogate.kernels.matern32 import MATERN32

__all__ = ["MATERN32_ARD"]

MATERN32_ARD = Ard("matern32_ard", MATERN32)
