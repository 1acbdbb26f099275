"""The slope of a density at its bounds, which a mirrored kernel estimate assumes to be zero."""

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr

__all__ = ["slope_correction"]

_BLOCK = 256
"""Points processed at once."""


def slope_correction(
    points: Float[np.ndarray, " point"],
    centres: Float[np.ndarray, " centre"],
    weights: Float[np.ndarray, " centre"],
    width: float,
    bounds: tuple[float, float],
) -> Float[np.ndarray, " point"]:
    """Return what to add to a mirrored Gaussian kernel estimate of one input so that it follows the slope at a bound.

    Mirrored kernels have no slope at a bound: if the true density falls towards it, the estimate is too high; if it
    rises, the estimate is too low. The local linear boundary kernel (Jones 1993, Statistics and Computing 3, 135) has
    no such error but more noise. The difference between the two is therefore shrunk by its own sampling variance, as in
    a James-Stein estimator: if the draws do not support a difference, the mirrored estimate stays as it is. Away from
    the bounds both are equal and nothing is added.

    Args:
        points: evaluation points inside the bounds (point,).
        centres: distinct draws (centre,).
        weights: their weights, which sum to one (centre,).
        width: standard deviation of the kernels.
        bounds: lower and upper bound; infinite if there is none.
    """
    blocks = np.array_split(points, max(1, -(-len(points) // _BLOCK)))
    return np.concatenate([_block(block, centres, weights, width, bounds) for block in blocks])


def _block(
    points: Float[np.ndarray, " point"],
    centres: Float[np.ndarray, " centre"],
    weights: Float[np.ndarray, " centre"],
    width: float,
    bounds: tuple[float, float],
) -> Float[np.ndarray, " point"]:
    below, above = ((bound - points) / width for bound in bounds)
    mass = ndtr(above) - ndtr(below)
    first = _normal(below) - _normal(above)
    second = mass + _moment(below) - _moment(above)
    z = (centres - points[:, None]) / width
    kernel = _normal(z)
    linear = (second[:, None] - first[:, None] * z) * kernel / (second * mass - first**2)[:, None]
    mirrored = kernel + sum(_normal((2 * b - centres - points[:, None]) / width) for b in bounds if np.isfinite(b))
    terms = (linear - mirrored) / width
    difference = terms @ weights
    variance = (terms - difference[:, None]) ** 2 @ weights**2
    kept = np.maximum(0.0, 1.0 - variance / np.maximum(difference**2, np.finfo(float).tiny))
    return np.asarray(kept * difference)


def _normal(z: Float[np.ndarray, "*point"]) -> Float[np.ndarray, "*point"]:
    return np.asarray(np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi))


def _moment(z: Float[np.ndarray, " point"]) -> Float[np.ndarray, " point"]:
    """Return z φ(z), zero at infinity."""
    finite = np.where(np.isfinite(z), z, 0.0)
    return np.asarray(finite * _normal(finite))
