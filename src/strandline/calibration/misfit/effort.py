"""How many draws and runs it takes to judge whether the model explains the observations."""

from dataclasses import dataclass

from strandline.calibration.misfit.verdict import FAMILIES, LEVEL

__all__ = ["DRAFT", "Effort"]


@dataclass(frozen=True)
class Effort:
    """Numbers of draws and runs; they limit how small a p-value can be.

    The defaults let one part of an arc alone flag a model, after the correction for its two tests and those of the
    other parts.

    Args:
        draws: Fewest drawn observations in all.
        per_part: Fewest drawn observations for each part of an arc.
        predictive: Draws of the posterior for the posterior-predictive comparison.
        runs: Most runs that a prediction is learnt from if there is no surrogate of the field.
    """

    draws: int = 4000
    per_part: int = 4 * round(FAMILIES / LEVEL)
    predictive: int = 2 * round(FAMILIES / LEVEL)
    runs: int = 64


DRAFT = Effort(draws=400, per_part=0, predictive=32, runs=16)
"""For a first look: p-values below .0025 cannot be told apart, and one part of an arc alone flags no model."""
