"""A test for residuals that vary slowly along the arc, as those of a wrong model do.

It looks at the residuals' components along a few cosine waves over the arc of each observed interface. A sum of squares
over all points spreads its power over as many directions as there are points, this one over a few: it is Neyman's
smooth test (1937) for residuals.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from strandline.interface import ErrorModel, Observation, arc_lengths, steady_lengths

__all__ = ["beyond", "waves_of", "waves_p"]

WAVES, FEWEST_POINTS = 6, 4
"""Waves along an arc, the first one constant, and the fewest points for each."""
TOGETHER = 0.01
"""Squared change of all residuals, in their standard deviations, by a combination of inputs over its prior, below which
these inputs only act together: differences cannot tell such a change, and it hardly moves a wave."""
EXPLAINED = 1e-6
"""Variance of a combination of waves, relative to the largest one, below which inputs or global errors explain it."""


def waves_of(observations: Sequence[Observation]) -> Float[np.ndarray, "seen wave"]:
    """Return cos(kπ s/L) at the points of each observed polyline, zero at those of the others; none for surfaces."""
    columns, first = [], 0
    total = sum(len(seen.interface.points) for seen in observations)
    for interface in (seen.interface for seen in observations):
        number = len(interface.points)
        if interface.dim == 2:
            places = np.pi * arc_lengths(interface) / float(steady_lengths(interface).sum())
            for k in range(min(WAVES, number // FEWEST_POINTS)):
                column = np.zeros(total)
                column[first : first + number] = np.cos(k * places)
                columns.append(column)
        first += number
    return np.stack(columns, axis=1) if columns else np.zeros((total, 0))


def beyond(
    waves: Float[np.ndarray, "seen wave"], by_inputs: Float[np.ndarray, "seen dim"], model: ErrorModel
) -> Float[np.ndarray, "seen wave"]:
    """Return the part Φ' of the waves that no input can cause: Φ'ᵀ C⁻¹ J = 0, but for what inputs hardly cause.

    Args:
        waves: The waves Φ.
        by_inputs: Change of the residuals with each input over its prior, J.
        model: Covariance C of the residuals.
    """
    if not by_inputs.size:
        return waves
    weighed = model.solved(by_inputs.T)
    values, vectors = np.linalg.eigh(weighed @ by_inputs)
    kept = values > TOGETHER
    told = vectors[:, kept]
    return np.asarray(waves - by_inputs @ (told / values[kept]) @ (told.T @ (weighed @ waves)))


def waves_p(drawn: Float[np.ndarray, "row wave"], observed: Float[np.ndarray, "1 wave"]) -> float | None:
    """Return the probability that a right model leaves waves as large; None without waves.

    The waves' sum of squares is taken after they are made independent, with the covariance of the drawn ones.

    Args:
        drawn: Components of drawn residuals along the waves.
        observed: Those of the observed residuals.
    """
    values, vectors = np.linalg.eigh(drawn.T @ drawn / len(drawn))
    kept = values > EXPLAINED * values.max(initial=0.0)
    if not kept.any():
        return None
    white = vectors[:, kept] / np.sqrt(values[kept])
    squares, own = ((drawn @ white) ** 2).sum(axis=1), float(((observed @ white) ** 2).sum())
    return float((1 + (squares >= own).sum()) / (1 + len(drawn)))
