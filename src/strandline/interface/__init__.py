"""Interfaces: polylines and triangulated surfaces, with a direction, and observations of them."""

from strandline.interface.interface import Interface, Oriented, oriented_like
from strandline.interface.noise import NOISES, GaussianNoise, Noise
from strandline.interface.observation import Observation, is_condition

__all__ = ["NOISES", "GaussianNoise", "Interface", "Noise", "Observation", "Oriented", "is_condition", "oriented_like"]
