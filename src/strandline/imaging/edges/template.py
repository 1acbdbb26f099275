"""The mean profile of a picture across an edge, and how bright each normal and each column is."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import gaussian_filter1d

from strandline.imaging.edges.strip import PerNormal, PerPlace, Samples, Strip

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
    samples, total = (
        gaussian_filter1d(np.bincount(columns[counts], weights, number), _COLUMN, mode="nearest")
        for weights in (np.ones(len(relative)), relative)
    )
    known = samples > 1e-9
    light = np.ones(number)
    light[known] = np.maximum(total[known] / samples[known], 1e-3)
    light /= np.exp(np.average(np.log(light), weights=samples))
    return replace(strip, samples=np.where(strip.usable, strip.samples / light[columns], 0.0))


def levelled(strip: Strip, expected: Samples) -> Strip:
    """Return a strip without the differences in brightness between normals, smooth along the edge, due to light.

    Light multiplies grey values, so that samples are divided by a gain.
    """
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
