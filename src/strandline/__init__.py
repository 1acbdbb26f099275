"""strandline: Bayesian calibration of computational-mechanics models from the shape of a measured interface."""

__version__ = "0.1.0"
