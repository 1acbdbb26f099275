"""Is the surrogate of the interface good enough where truths come from, compared with what the noise hides?"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.calibration.source import Source
from strandline.likelihood import FieldLikelihood, noise_length
from strandline.surrogate.field import FieldSurrogate

__all__ = ["TOLERATED", "TOLERATED_SHARE", "FieldQuality", "field_quality", "quality_at"]

TOLERATED = 0.5
"""Error of the predicted interface that is tolerated, as a share of the shift that the noise hides."""
TOLERATED_SHARE = 0.05
"""Share of the draws at which a larger error is tolerated."""
DRAWS = 512


@dataclass(frozen=True)
class FieldQuality:
    """Errors of the predicted interface, root mean square along it, at draws of a distribution; mm.

    Args:
        hidden: Shift of the observed interface that the noise hides, the smallest of all conditions.
        median: Median of the errors that the surrogate expects.
        q95: Their 95 % quantile.
        left_out: Median error at runs that are predicted from the others.
        beyond: Share of the draws with an error above `TOLERATED` times `hidden`.
    """

    hidden: float
    median: float
    q95: float
    left_out: float
    beyond: float

    @property
    def good(self) -> bool:
        """Whether few enough of the draws have too large an error."""
        return self.beyond <= TOLERATED_SHARE


def field_quality(source: Source) -> FieldQuality:
    """Return how good the surrogate is at draws of a distribution."""
    return quality_at(source.knowledge.likelihood, source.points, np.exp(source.log_weights))


def quality_at(
    likelihood: FieldLikelihood, points: Float[np.ndarray, "point dim"], weights: Float[np.ndarray, " point"]
) -> FieldQuality:
    """Return how good the surrogate is at weighted points, for the noise of a likelihood.

    The errors that it expects count more if those at left-out runs are larger than expected.

    Args:
        likelihood: Likelihood through the surrogate.
        points: Inputs, shape (point, dim).
        weights: Their weights, whose sum is 1, shape (point,).
    """
    surrogate = likelihood.surrogate
    hidden = min(noise_length(seen, likelihood.discrepancy) for seen in likelihood.known_observations)
    chosen = np.random.default_rng(0).choice(len(weights), DRAWS, p=weights / weights.sum())
    errors = max(1.0, _surprise(surrogate)) * surrogate.predicted_error(points[chosen])
    median, q95 = np.quantile(errors, [0.5, 0.95]).tolist()
    return FieldQuality(
        hidden=hidden,
        median=median,
        q95=q95,
        left_out=float(np.median(surrogate.left_out_error())),
        beyond=float((errors > TOLERATED * hidden).mean()),
    )


def _surprise(surrogate: FieldSurrogate) -> float:
    """Return the root mean square error at left-out runs over the expected one."""
    left_out = [process.left_out() for process in surrogate.processes]
    found = sum(float(np.sum(one.errors**2)) for one in left_out)
    expected = sum(float(np.sum(one.variances)) for one in left_out)
    return float(np.sqrt(found / expected)) if expected > 0 else 1.0
