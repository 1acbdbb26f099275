"""What a smooth error of the log-likelihood does to a posterior: a parabola through log ratios at some of its draws.

The logarithm δ of true over expected likelihood is taken as a + Σ (b_k y_k + c_k y_k²) along the principal axes y of
the posterior, plus independent errors; in up to three dimensions as a whole quadratic function. The coefficients have
Student's t distribution around their least-squares estimate. Weights exp(δ) of many draws then show how far each mean
and each standard deviation would move.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

__all__ = ["Effect", "fewest", "smooth_effect"]

SAMPLES = 400
"""Sets of coefficients drawn."""
FREEDOM = 3
"""Degrees of freedom that must be left."""
WHOLE = 3
"""Largest dimension with products of the axes."""
_SEED = 5


@dataclass(frozen=True, eq=False)
class Effect:
    """How far the posterior would move, and bounds that hold with a given probability each.

    Args:
        shift: Largest shift of a mean, in standard deviations.
        shift_bounds: Its lower and upper bound.
        width: Largest change of the logarithm of a standard deviation.
        width_bounds: Its lower and upper bound.
        effective_bounds: Lower and upper bound of the effective share of draws.
    """

    shift: float
    shift_bounds: tuple[float, float]
    width: float
    width_bounds: tuple[float, float]
    effective_bounds: tuple[float, float]


def fewest(dim: int) -> int:
    """Return the fewest draws from which an effect can be found."""
    return 1 + 2 * dim + (dim * (dim - 1) // 2 if dim <= WHOLE else 0) + FREEDOM


def smooth_effect(
    draws: Float[np.ndarray, "draw dim"],
    log_ratios: Float[np.ndarray, " draw"],
    posterior: Float[np.ndarray, "particle dim"],
    level: float,
    *,
    scatter: float = 0.0,
) -> Effect:
    """Return the effect of a smooth error.

    Args:
        draws: Draws, at least `fewest` of them, not necessarily of equal weight.
        log_ratios: Values of δ at the draws, all finite.
        posterior: Many draws of equal weight.
        level: Probability that each bound is exceeded.
        scatter: Variance of δ by the simulator's own scatter, which is no error of the posterior. It widens the bounds
            of shifts and widths, as all scatter does, but is taken out of those of the effective share.
    """
    mean, sd = posterior.mean(axis=0), posterior.std(axis=0)
    values, vectors = np.linalg.eigh(np.atleast_2d(np.cov(((posterior - mean) / sd).T)))
    axes = vectors / np.sqrt(np.maximum(values, 1e-12))

    def terms(x: Float[np.ndarray, "some dim"]) -> Float[np.ndarray, "some term"]:
        y = (x - mean) / sd @ axes
        products = [y[:, i] * y[:, j] for i in range(y.shape[1]) for j in range(i)] if y.shape[1] <= WHOLE else []
        return np.column_stack([np.ones(len(x)), y, y**2, *products])

    A, B = terms(draws), terms(posterior)
    q, r = np.linalg.qr(A)
    best = np.linalg.solve(r, q.T @ log_ratios)
    freedom = len(A) - A.shape[1]
    rest = float(np.sum((log_ratios - A @ best) ** 2))
    random = np.random.default_rng(_SEED)
    spread = np.linalg.solve(r, random.standard_normal((A.shape[1], SAMPLES))).T
    variances = rest / random.chisquare(freedom, SAMPLES)
    drawn = np.vstack([best, best + spread * np.sqrt(variances)[:, None]])
    shift, width, size = _moved(posterior, (mean, sd), drawn @ B.T)
    sure, least = (float(np.quantile(size[1:], p)) for p in (1 - level, level))
    most, few = rest / float(chi2.ppf(level, freedom)), rest / float(chi2.ppf(1 - level, freedom))
    most, few = max(most - scatter, 0.0), max(few - scatter, 0.0)
    return Effect(
        float(shift[0]),
        (float(np.quantile(shift[1:], level)), float(np.quantile(shift[1:], 1 - level))),
        float(width[0]),
        (float(np.quantile(width[1:], level)), float(np.quantile(width[1:], 1 - level))),
        (math.exp(-sure - most), math.exp(-least - few)),
    )


def _moved(
    posterior: Float[np.ndarray, "particle dim"],
    moments: tuple[Float[np.ndarray, " dim"], Float[np.ndarray, " dim"]],
    log_ratios: Float[np.ndarray, "sample particle"],
) -> tuple[Float[np.ndarray, " sample"], Float[np.ndarray, " sample"], Float[np.ndarray, " sample"]]:
    """Return the largest shift, the largest change of a log sd, and minus the log of the effective share."""
    mean, sd = moments
    weights = np.exp(log_ratios - log_ratios.max(axis=1, keepdims=True))
    weights /= weights.sum(axis=1, keepdims=True)
    z = (posterior - mean) / sd
    means = weights @ z
    variances = np.maximum(weights @ z**2 - means**2, 1e-12)
    effective = 1.0 / (weights**2).sum(axis=1) / len(z)
    return np.abs(means).max(axis=1), np.abs(0.5 * np.log(variances)).max(axis=1), -np.log(np.minimum(effective, 1.0))
