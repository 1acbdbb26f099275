"""The covariance of a picture's noise along and across the normals, and what it does to the points of an edge.

Samples half a pixel apart share pixels, so that they are not independent, and a fit takes part of the noise out of its
residuals. Both are accounted for: the autocovariance is estimated from the residuals, corrected for what the fit takes
out on average, and carried through the linearised fit. This gives the standard deviation of the points and their
correlation along the edge without smoothing it.
"""

import math

import numpy as np
from jaxtyping import Bool, Float
from scipy.fft import next_fast_len
from scipy.linalg import toeplitz
from scipy.ndimage import gaussian_filter1d

from strandline.imaging.edges.located import Scatter
from strandline.imaging.edges.strip import PerNormal, PerPlace, Samples

Lags = Float[np.ndarray, "along across"]
_ALONG, _ACROSS = 12, 10
"""Longest lags at which noise is taken as correlated: normals along the edge, samples across it."""
_SMOOTH = 8.0
"""Standard deviation of the Gaussian along the edge whose result roughness is measured against, in normals."""
LEAST_LENGTH = 1.0
"""Smallest integral correlation length that a picture can show, px."""


def noise_covariance(
    residuals: Samples, usable: Bool[np.ndarray, "normal place"], basis: Float[np.ndarray, "place column"]
) -> Lags:
    """Return the autocovariance of the noise at lags (normals along the edge, samples across it), both from 0.

    `residuals`: residuals of a fit, 0 where not usable; `usable`: samples that count; `basis`: columns of the
    linearised fit on one normal: what it took out of the residuals.
    """
    found = autocovariance(residuals, usable)
    remaining = np.eye(len(basis)) - basis @ np.linalg.pinv(basis)
    lags = min(_ACROSS, len(basis) - 1) + 1
    seen = [remaining @ toeplitz(one) @ remaining.T for one in np.eye(len(basis))[:lags]]
    response = np.array([[np.trace(one, k) / (len(basis) - k) for k in range(lags)] for one in seen])
    return np.asarray(np.linalg.lstsq(response.T, found[:, :lags].T, rcond=1e-3)[0].T)


def scatter_of(places: PerNormal, covariance: Lags, influence: PerPlace) -> Scatter:
    """Return the random errors of points along an edge: the larger of two estimates of s.

    One carries the noise through the linearised fit, the other is the roughness of the edge.

    `places`: distances of the points from a smooth course; NaN where the edge was not found. `covariance`:
    autocovariance of the noise. `influence`: change of a point per unit of noise in each sample of its normal.
    """
    lags = np.abs(np.subtract.outer(np.arange(len(influence)), np.arange(len(influence))))
    padded = np.zeros((len(covariance), len(influence)))
    padded[:, : covariance.shape[1]] = covariance[:, : len(influence)]
    through = np.array([influence @ row[lags] @ influence for row in padded])
    if not through[0] > 0:
        return Scatter(roughness(places, np.array([1.0])), LEAST_LENGTH)
    shares = through / through[0]
    length = max(sum_to_first_zero(shares), LEAST_LENGTH)
    return Scatter(max(math.sqrt(through[0]), roughness(places, shares)), length)


def roughness(places: PerNormal, shares: Float[np.ndarray, " along"]) -> float:
    """Return the standard deviation of points about a smooth line through them, corrected for what that line follows.

    `places`: distances of the points from a smooth course; NaN where the edge was not found. `shares`: autocorrelation
    of their errors along the edge, from lag 0.
    """
    known = np.isfinite(places)
    if known.sum() < 3:
        return math.nan
    filled = np.where(known, places, 0.0)
    weight = gaussian_filter1d(known.astype(float), _SMOOTH, mode="constant")
    rough = (filled - gaussian_filter1d(filled, _SMOOTH, mode="constant") / np.maximum(weight, 1e-9))[known]
    kernel = np.zeros(2 * int(4 * _SMOOTH) + 1)
    kernel[len(kernel) // 2] = 1.0
    kernel -= gaussian_filter1d(kernel, _SMOOTH, mode="constant")
    own = np.correlate(kernel, kernel, "full")[len(kernel) - 1 :]
    left = own[0] + 2 * float((own[1 : len(shares)] * shares[1:]).sum())
    spread = 1.4826 * float(np.median(np.abs(rough - np.median(rough))))  # a few wrong points do not count
    return min(float(np.std(rough)), 1.5 * spread or math.inf) / math.sqrt(max(left, 0.1))


def ratio(contrast: float, noise: float) -> float:
    """Return contrast over noise, infinite without noise."""
    return contrast / noise if noise != 0 else math.inf


def sum_to_first_zero(shares: Float[np.ndarray, " lag"]) -> float:
    """Return ½ + Σ ρ, the integral of an autocorrelation up to its first zero, in lags."""
    below = np.flatnonzero(shares <= 0)
    return 0.5 + float(shares[1 : below[0] if below.size else None].sum())


def autocovariance(residuals: Samples, usable: Bool[np.ndarray, "normal place"]) -> Lags:
    """Return mean products of residuals at lags (along, across), means over both signs of the second."""
    along, across = min(_ALONG, residuals.shape[0] - 1) + 1, residuals.shape[1]
    shape = [next_fast_len(residuals.shape[0] + along, real=True), next_fast_len(2 * across, real=True)]

    def products(values: Samples) -> Lags:
        return np.asarray(np.fft.irfft2(np.abs(np.fft.rfft2(values, shape)) ** 2, shape))

    sums, counts = products(residuals), products(usable.astype(float))
    mirrored = -np.arange(across)
    total = sums[:along, :across] + sums[:along, mirrored]
    number = counts[:along, :across] + counts[:along, mirrored]
    return np.asarray(total / np.maximum(number, 1.0))
