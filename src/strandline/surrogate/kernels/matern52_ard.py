"""Matérn 5/2 with a length for each input: (1 + t + t²/3) exp(-t), t = √5 s, s² = Σ_d ((x_d - x'_d) / l_d)²."""

from strandline.surrogate.kernels.ard import Ard
from strandline.surrogate.kernels.matern52 import MATERN52

__all__ = ["MATERN52_ARD"]

MATERN52_ARD = Ard("matern52_ard", MATERN52)
