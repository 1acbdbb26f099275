"""Which runs to make: points that fill the box, refinement where the posterior lies, active designs."""

from strandline.design.space_filling import sobol

__all__ = ["sobol"]
