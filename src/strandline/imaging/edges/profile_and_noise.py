"""What a strip shows: the mean profile across the edge, its light, and the noise of its samples.

Samples half a pixel apart share pixels, so that they are not independent, and a fit takes part of the noise out of its
residuals. Both are accounted for: the autocovariance is estimated from the residuals, corrected for what the fit takes
out on average, and carried through the linearised fit. This gives the standard deviation of the points and their
correlation along the edge without smoothing it.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.fft import next_fast_len
from scipy.linalg import toeplitz
from scipy.ndimage import gaussian_filter1d

from strandline.imaging.edges.strip import PerNormal, PerPlace, Samples, Scatter, Strip

PLATEAU = (3.0, 7.0)
"""Distances from the edge between which the grey value on either side of it is taken, px."""
_SHADOW = 5.0
"""Standard deviation of the Gaussian along the edge by which the gain of the normals is smoothed, px."""
_COLUMN = 3.0
"""Standard deviation of the Gaussian over which the light of columns is averaged, in columns: shadows are wider."""
_FAR, _BROAD = 5.0, 2.0
"""Distance from the edge beyond which the profile is smoothed, and by a Gaussian of which standard deviation, px."""
_FEW = 0.2
"""Share of the normals below which the profile is continued by its last value."""


@dataclass(frozen=True, eq=False)
class EdgeTemplate:
    """A mean profile across an edge.

    `values`: mean grey value at each place; `places`: distances v from the edge, shape (place,), above 0 on the left;
    `left`: mean grey value on the left, 3 to 7 px away; `right`: mean grey value on the right.
    """

    values: PerPlace
    places: PerPlace
    left: float
    right: float

    def at(self, places: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the profile at distances from the edge."""
        return np.asarray(np.interp(places, self.places, self.values))

    @property
    def blur(self) -> float:
        """Standard deviation of the blurred step with the slope of the profile at its half level, px."""
        near = np.abs(self.places) <= 1.0
        slope = abs(np.polyfit(self.places[near], self.values[near], 1)[0])
        return float(abs(self.left - self.right) / (np.sqrt(2 * np.pi) * max(slope, 1e-12)))


def aligned(
    values: Samples, strip: Strip, offsets: PerNormal, places: Float[np.ndarray, " wanted"]
) -> tuple[Float[np.ndarray, "normal wanted"], Float[np.ndarray, "normal wanted"]]:
    """Return values at distances from the edge instead of the course, and their weights: 0 where not usable."""
    index = (places[None] + offsets[:, None] - strip.places[0]) / strip.step
    first = np.clip(np.floor(index).astype(int), 0, len(strip.places) - 2)
    share = index - first
    rows = np.arange(len(values))[:, None]
    inside = (share >= 0) & (share <= 1) & strip.usable[rows, first] & strip.usable[rows, first + 1]
    found = (1 - share) * values[rows, first] + share * values[rows, first + 1]
    return np.where(inside, found, 0.0), inside.astype(float)


def learnt_template(strip: Strip, offsets: PerNormal) -> tuple[EdgeTemplate, float]:
    """Return the mean profile over all normals, and the distance from `offsets` to its half level.

    The samples are free of differences in brightness; `offsets` are the distances of the edge from the course.
    """
    values, weights = aligned(strip.samples, strip, offsets, strip.places)
    number = weights.sum(axis=0)
    mean = values.sum(axis=0) / np.maximum(number, 1e-9)
    known = np.flatnonzero(number >= _FEW * number.max())
    mean = np.interp(strip.places, strip.places[known], mean[known])
    broad = gaussian_filter1d(mean, _BROAD / strip.step, mode="nearest")
    share = np.clip(np.abs(strip.places) - _FAR, 0.0, 1.0)
    mean = (1 - share) * mean + share * broad
    shift = _half_level(mean, strip.places)
    left, right = _plateaux(mean, strip.places - shift)
    return EdgeTemplate(mean, strip.places - shift, left, right), shift


def columns_levelled(
    strip: Strip, expected: Samples, offsets: PerNormal, columns: Int[np.ndarray, "normal place"]
) -> Strip:
    """Return a strip without the differences in brightness between columns of the picture.

    A shadow follows the beam, which runs down the columns: on a steep flank one normal lies half in it. The light of a
    column is the mean of its samples over `expected`, what the profile predicts. That accounts for the two sides, so
    that the step at a vertical flank is no shadow; samples less than 3 px from the edge, where a wrong offset would
    be, do not count.
    """
    counts = strip.usable & (np.abs(strip.places - offsets[:, None]) > PLATEAU[0]) & (expected > 0)
    if not counts.any():
        return strip
    relative, number = strip.samples[counts] / expected[counts], int(columns.max()) + 1
    sums = [np.bincount(columns[counts], one, number) for one in (np.ones(len(relative)), relative)]
    samples, total = gaussian_filter1d(sums, _COLUMN, mode="nearest")
    known = samples > 1e-9
    light = np.ones(number)
    light[known] = np.maximum(total[known] / samples[known], 1e-3)
    light /= np.exp(np.average(np.log(light), weights=samples))
    return replace(strip, samples=np.where(strip.usable, strip.samples / light[columns], 0.0))


def levelled(strip: Strip, expected: Samples) -> Strip:
    """Return a strip divided by a gain that is smooth along the edge: light multiplies the grey values of normals."""
    mode = "wrap" if strip.course.closed else "nearest"
    apart = strip.samples / np.where(expected > 0, expected, np.inf)
    total = gaussian_filter1d((strip.usable * apart).sum(axis=1), _SHADOW, mode=mode)
    light = total / np.maximum(gaussian_filter1d(strip.usable.sum(axis=1).astype(float), _SHADOW, mode=mode), 1e-9)
    light = np.maximum(light, 1e-3)
    samples = strip.samples / (light / np.exp(np.mean(np.log(light))))[:, None]
    return replace(strip, samples=np.where(strip.usable, samples, 0.0))


def _half_level(mean: PerPlace, places: PerPlace) -> float:
    """Return where the profile crosses the mean of its two plateaux, next to the place found so far."""
    shift = 0.0
    for _ in range(10):
        left, right = _plateaux(mean, places - shift)
        above = mean - 0.5 * (left + right)
        crossing = np.flatnonzero((above[:-1] * above[1:] <= 0) & ((above[1:] > above[:-1]) == (left > right)))
        if not crossing.size:
            return shift
        at = places[crossing] + (places[1] - places[0]) * above[crossing] / (above[crossing] - above[crossing + 1])
        new = float(at[np.argmin(np.abs(at - shift))])
        if abs(new - shift) < 1e-6:
            break
        shift = new
    return float(np.clip(shift, -3.0, 3.0))


def _plateaux(mean: PerPlace, places: PerPlace) -> tuple[float, float]:
    left = (places >= PLATEAU[0]) & (places <= PLATEAU[1])
    right = (places <= -PLATEAU[0]) & (places >= -PLATEAU[1])
    return float(mean[left].mean()), float(mean[right].mean())


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
