"""Designs of experiments: points of the unit cube at which the simulator is run."""

import numpy as np
from jaxtyping import Float
from scipy.stats import qmc

from strandline.foundations import InvalidInput

__all__ = ["sobol"]


MOST_POINTS = 2**24
MOST_INPUTS = qmc.Sobol.MAXDIM
"""Largest number of inputs for which direction numbers are known."""


def sobol(number: int, dim: int, *, scramble: int | None = None) -> Float[np.ndarray, "run dim"]:
    """Return the first `number` points of one Sobol sequence in the unit cube.

    Designs are nested: a larger one begins with the smaller one and reuses its runs. `scramble` is the seed of an Owen
    scrambling; None (the default) is the plain sequence, whose first point is the origin.

    Raises:
        InvalidInput: `number` or `dim` below 1, or more than the sequence has.
    """
    if not 1 <= number <= MOST_POINTS or not 1 <= dim <= MOST_INPUTS:
        raise InvalidInput(
            "size of the Sobol design",
            value=f"{number} points in {dim} dimensions",
            expected=f"at least 1 of each, at most {MOST_POINTS} points and {MOST_INPUTS} dimensions",
            remedy="Ask for another number of runs.",
        )
    engine = qmc.Sobol(dim, scramble=scramble is not None, rng=scramble)
    return np.asarray(engine.random_base2(max(number - 1, 0).bit_length())[:number])
