"""The edge as the contour at the half level between its two sides, for clean pictures."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter1d

from strandline.imaging.edges.located import NO_SCATTER, Located
from strandline.imaging.edges.noise_covariance import noise_covariance, ratio, scatter_of
from strandline.imaging.edges.strip import GreyValues, PerNormal, PerPlace, SmoothPath, Strip, strip_along
from strandline.imaging.edges.template import PLATEAU, EdgeTemplate, learnt_template

_LEVELS = 5.0
"""Standard deviation of the Gaussian along the edge by which the grey values on both sides are smoothed, px."""


@dataclass(frozen=True)
class HalfLevel:
    """Find the edge where the grey value crosses the mean of those 3 to 7 px away on either side.

    Args:
        reach: Half the length of the normals, px.
        step: Distance of the samples, px.
        smooth: Standard deviation of the Gaussian that smooths each normal, px.
        bias: Standard deviation of a common offset where the edge is straight, px.
        passes: Number of passes.
    """

    reach: float = 10.0
    step: float = 0.5
    smooth: float = 1.0
    bias: float = 0.1
    passes: int = 3

    def locate(self, picture: GreyValues, course: SmoothPath, counted: Bool[np.ndarray, " normal"] | None) -> Located:
        """Return the edge near a course; see `EdgeMethod`."""
        strip = strip_along(picture, course, reach=self.reach, step=self.step)
        right, left = _levels(strip)
        contrast = float(np.median(left - right))
        offsets, found = self._crossings(strip, right, left, up=contrast > 0)
        scale = np.where(np.abs(left - right) > 0, left - right, math.inf)
        relative = np.where(strip.usable, (strip.samples - right[:, None]) / scale[:, None], 0.0)
        normalised = Strip(relative, strip.usable & found[:, None], strip.places, course)
        template, _ = learnt_template(normalised, offsets)
        noise, scatter = math.nan, NO_SCATTER
        if counted is not None and (counted & found).any():
            kept = counted & found
            weights = strip.usable & kept[:, None]
            expected = template.at(strip.places - offsets[:, None])
            residuals = np.where(weights, (relative - expected) * (left - right)[:, None], 0.0)
            row, basis = self._influence(template, strip.places, contrast)
            covariance = noise_covariance(residuals, weights, basis)
            scatter = scatter_of(np.where(kept, offsets, math.nan), covariance, row)
            noise = math.sqrt(max(float(covariance[0, 0]), 0.0) / strip.kept)
        return Located(
            strip=strip,
            offsets=offsets,
            sds=np.full(len(offsets), scatter.sd),
            found=found,
            at_limit=found & (np.abs(offsets) > self.reach - 1.0),
            scatter=scatter,
            blur=template.blur,
            contrast=contrast,
            contrast_to_noise=ratio(abs(contrast), noise),
            facts={"noise": noise},
        )

    def _crossings(
        self, strip: Strip, right: PerNormal, left: PerNormal, *, up: bool
    ) -> tuple[PerNormal, Bool[np.ndarray, " normal"]]:
        """Return the crossing of the half level nearest to the course on each normal, and where there is one."""
        weight = gaussian_filter1d(strip.usable.astype(float), self.smooth / strip.step, axis=1)
        values = gaussian_filter1d(strip.samples, self.smooth / strip.step, axis=1) / np.maximum(weight, 1e-9)
        above = (values - 0.5 * (left + right)[:, None]) * (1.0 if up else -1.0)
        crosses = (above[:, :-1] <= 0) & (above[:, 1:] > 0) & strip.usable[:, :-1] & strip.usable[:, 1:]
        change = np.where(crosses, above[:, 1:] - above[:, :-1], 1.0)
        at = strip.places[:-1] - strip.step * np.where(crosses, above[:, :-1], 0.0) / change
        nearest = np.argmin(np.where(crosses, np.abs(at), math.inf), axis=1)
        found = crosses.any(axis=1)
        return np.where(found, at[np.arange(len(at)), nearest], 0.0), found

    def _influence(
        self, template: EdgeTemplate, places: PerPlace, contrast: float
    ) -> tuple[PerPlace, Float[np.ndarray, "place 1"]]:
        """Return the change of the edge per unit of noise in each sample, and what alignment takes out of residuals."""
        step = float(places[1] - places[0])
        kernel = gaussian_filter1d((np.abs(places) < 0.5 * step).astype(float), self.smooth / step)
        profile = template.at(places)
        smooth = gaussian_filter1d(profile, self.smooth / step)
        slope = float(np.gradient(smooth, places)[len(places) // 2])
        return -kernel / (contrast * slope or math.inf), np.gradient(profile, places)[:, None]


def _levels(strip: Strip) -> tuple[PerNormal, PerNormal]:
    """Return the grey values on the right and on the left of the path, smoothed along it."""
    mode, out = "wrap" if strip.course.closed else "nearest", []
    for side in (-1.0, 1.0):
        there = (side * strip.places >= PLATEAU[0]) & (side * strip.places <= PLATEAU[1])
        weight = gaussian_filter1d(strip.usable[:, there].sum(axis=1).astype(float), _LEVELS, mode=mode)
        total = gaussian_filter1d(strip.samples[:, there].sum(axis=1), _LEVELS, mode=mode)
        out.append(total / np.maximum(weight, 1e-9))
    return out[0], out[1]
