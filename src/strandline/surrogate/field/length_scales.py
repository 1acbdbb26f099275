"""How much less a mode is known than at its most probable length scales, which few runs leave uncertain.

The variances of a process are those at one set of length scales, with its own variance s² as it is found there.
Averaged over the posterior of both they are larger. Draws of the logarithms of the length scales, from a Gaussian
around the most probable ones, are weighted by their posterior (importance sampling). The mixture of the processes has
the variance

    Σ w_k (v_k + (m_k - m)²),

m the mean that is used. With s² integrated out too, a process is Student's t with N - p degrees of freedom, whose
variance is (N - p)/(N - p - 2) times as large (Handcock and Stein, A Bayesian analysis of kriging, Technometrics 35,
403-410, 1993).
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from jaxtyping import Float
from scipy.special import softmax
from scipy.stats import norm, qmc

__all__ = ["mixed_variance", "student"]

DRAWS, WIDER = 32, 1.5
"""Length scales drawn besides the most probable ones, in pairs on both sides, from a Gaussian wider by this factor: the
posterior has heavy tails."""
STEP = 0.05
"""Step of the finite differences, in the logarithm of the length scales."""
POINTS = 64
"""Inputs over the box at which variances are compared."""
FEWEST_FREEDOM = 1
"""Least degrees of freedom besides two that count: fewer give no variance."""

Objective = Callable[[Float[np.ndarray, " coordinate"]], tuple[float, Float[np.ndarray, " coordinate"]]]
Predicted = Callable[
    [Float[np.ndarray, " coordinate"], Float[np.ndarray, "point dim"]],
    tuple[float, Float[np.ndarray, " point"], Float[np.ndarray, " point"]] | None,
]


def student(rows: int, terms: int) -> float:
    """Return the variance of Student's t with N - p degrees of freedom, over that of a Gaussian.

    Args:
        rows: Number N of observations.
        terms: Number p of terms of the mean.
    """
    left = max(rows - terms - 2, FEWEST_FREEDOM)
    return (left + 2) / left


def mixed_variance(
    objective: Objective,
    predicted: Predicted,
    at: Float[np.ndarray, " coordinate"],
    low: Float[np.ndarray, " coordinate"],
    high: Float[np.ndarray, " coordinate"],
    *,
    least: float,
) -> float:
    """Return the variance with uncertain length scales over that at the most probable ones, mean over the box; above 1.

    Args:
        objective: Function that returns minus the log posterior of the hyperparameters, and its derivatives.
        predicted: Function that returns minus the log posterior again, and means and variances of the mode at points in
            standardised inputs; None if it has none. The last hyperparameter, the nugget, stays the same.
        at: Most probable hyperparameters: logarithms of the length scales and of the nugget.
        low: Their lower bounds.
        high: Their upper bounds.
        least: Least second derivative of minus the log posterior in the logarithm of a length scale.
    """
    dim = len(at) - 1
    _, slope = objective(at)
    H = np.array([objective(at + step)[1][:dim] - slope[:dim] for step in STEP * np.eye(dim, dim + 1)]) / STEP
    sizes, axes = np.linalg.eigh(0.5 * (H + H.T))
    z = _normal(dim)
    tried = np.repeat(at[None], len(z), axis=0)
    tried[:, :dim] += (WIDER * z / np.sqrt(np.maximum(sizes, least))) @ axes.T
    tried = np.clip(tried, low, high)
    points = _points(dim)
    first = predicted(at, points)
    assert first is not None
    found = [(first, 0.0)]
    for row, normal in zip(tried, z, strict=True):
        one = predicted(row, points)
        if one is not None:
            found.append((one, 0.5 * float(normal @ normal)))
    weights = softmax([proposal - value for (value, _, _), proposal in found])
    mixed = sum(w * (v + (m - first[1]) ** 2) for w, ((_, m, v), _) in zip(weights, found, strict=True))
    tiny = np.finfo(float).tiny
    return max(float(np.mean(mixed / np.maximum(first[2], tiny))), 1.0)


@lru_cache(maxsize=16)
def _normal(dim: int) -> Float[np.ndarray, "draw dim"]:
    """Return standard normal numbers, each with its opposite."""
    half = norm.ppf(np.clip(qmc.Sobol(dim, seed=np.random.default_rng(0)).random(DRAWS // 2), 1e-6, 1 - 1e-6))
    return np.concatenate([half, -half])


@lru_cache(maxsize=16)
def _points(dim: int) -> Float[np.ndarray, "point dim"]:
    """Return standardised inputs that fill the box."""
    return np.asarray(np.sqrt(12.0) * (qmc.Sobol(dim, seed=np.random.default_rng(1)).random(POINTS) - 0.5))
