"""The edge as a path over all normals at once, for speckle: a template, a likelihood, and a random walk.

All normals share the mean profile T(v) across the edge. A normal on which the edge lies at o has the log-likelihood
-κ Σ k (I/m + log m) with m = g T(u - o): the grey values I are gamma distributed with mean m and shape k, like the
intensity of speckle (k = 1 for one look), and light and shadow multiply them by a gain g: one for each column of the
picture, down which the beam runs, times one that is smooth along the edge.
Neighbouring samples are not independent, so κ is one over the number of them that count as one. The offsets follow a
random walk along the edge.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import gaussian_filter

from strandline.foundations import unfit
from strandline.imaging.edges.profile_and_noise import (
    LEAST_LENGTH,
    EdgeTemplate,
    autocovariance,
    columns_levelled,
    learnt_template,
    levelled,
    sum_to_first_zero,
)
from strandline.imaging.edges.strip import GreyValues, Located, Normals, Scatter, SmoothPath, Strip, strip_along

Table = Float[np.ndarray, "normal candidate"]
Candidates = Float[np.ndarray, " candidate"]
_SLOW = 7.5
"""Standard deviation of the Gaussian whose result is taken off residuals before they are correlated: what varies over
more than 15 px is no speckle."""
_LAGS = 8.0
"""Longest distance at which samples are taken as correlated, px."""
_EDGE = 1.4
"""Samples at an edge that count as one, over those away from it, measured on rendered scans: beside the edge both sides
share the scatterers of the brighter one."""
_SIDE = 10.0
"""Side of the square over which grey values are averaged to define the contrast to noise, px."""
_DRAWS, _SEED = 40, 16
_LONGEST = 200
"""Longest distance along the edge at which drawn paths are correlated, px."""
_OVERLAP = 60
"""Normals by which a closed path overlaps itself."""
_SYMMETRIC = 0.5
"""Skewness over the relative standard deviation below which grey values are no linear intensity: it is 2 for gamma
distributed ones, 1.2 for amplitudes, 0 for a camera's noise and below 0 for logarithms."""


@dataclass(frozen=True)
class MarkovPath:
    """Find the edge as a path over all normals at once.

    Args:
        reach: Largest distance of the edge from the path, px.
        support: Length of the profile beyond that, on either side, px.
        step: Distance of samples and candidates, px.
        drift: Standard deviation τ of a step of the random walk, px; at least half of `step`.
        rounds: Number of times that template, gain, κ and path are found in turn, in each pass.
        bias: Standard deviation of a common offset where the edge is straight, px.
        passes: Number of passes.
    """

    reach: float = 10.0
    support: float = 10.0
    step: float = 0.5
    drift: float = 0.3
    rounds: int = 4
    bias: float = 0.4
    passes: int = 2

    def __post_init__(self) -> None:
        if self.drift < 0.5 * self.step:
            expected = f"at least half the distance of candidates, {0.5 * self.step:g} px"
            remedy = "Raise the drift or lower the step: otherwise the path could not move."
            raise unfit("drift of the path of an edge", self.drift, expected, remedy)

    def locate(self, picture: GreyValues, course: SmoothPath, counted: Normals | None) -> Located:
        """Return the edge near a course; see `EdgeMethod`."""
        _require_intensity(picture)
        strip = strip_along(picture, course, reach=self.reach + self.support, step=self.step)
        places = strip.places[np.abs(strip.places) <= self.reach + 1e-9]
        columns = _columns(picture, strip)
        offsets, even = np.zeros(len(course.points)), strip
        for turn in range(self.rounds):
            template, shift = learnt_template(even, offsets)
            expected = template.at(strip.places - (offsets + shift)[:, None])
            even = levelled(columns_levelled(strip, expected, offsets + shift, columns), expected)
            speckle = _Speckle.of(even, expected)
            table = self._table(even, template, places, speckle)
            draws = _DRAWS if counted is not None and turn == self.rounds - 1 else 0
            path = _walk(table, places, self.drift, course.closed, draws)
            offsets = path.mean
        if counted is not None:
            _require_speckle(speckle.skewness, math.sqrt(speckle.variance))
        found = strip.usable[:, np.abs(strip.places) <= self.support / 2].mean(axis=1) > 0.5
        at_limit = found & (np.abs(offsets) > self.reach - 1.0)
        scatter = Scatter() if counted is None else _scatter(path, found & counted)
        edge = strip, offsets, path.sd, found, at_limit, scatter
        to_noise = speckle.contrast_to_noise(template)
        facts = {"kappa": speckle.kappa, "speckle_variance": speckle.variance, "skewness": speckle.skewness}
        return Located(*edge, template.blur, template.left - template.right, to_noise, facts)

    def _table(self, strip: Strip, template: EdgeTemplate, places: Candidates, speckle: "_Speckle") -> Table:
        m = template.at(strip.places - places[:, None])
        m = np.maximum(m, 1e-6 * float(m.max()))
        usable, weight = strip.usable.astype(float), speckle.kappa / speckle.variance
        return np.asarray(-weight * (strip.samples @ (1 / m).T + usable @ np.log(m).T))


@dataclass(frozen=True)
class _Speckle:
    """Relative residuals of a strip, I/m - 1.

    `variance`: their variance; `kappa`: one over the number of samples that count as one; `area`: area that counts as
    one, px²; `skewness`: their skewness.
    """

    variance: float
    kappa: float
    area: float
    skewness: float

    @classmethod
    def of(cls, strip: Strip, expected: Float[np.ndarray, "normal place"]) -> "_Speckle":
        """Estimate them from a strip and what is expected of it."""
        usable = strip.usable.astype(float)
        scale = np.maximum(expected, 1e-6 * float(np.abs(expected).max()))
        residuals = np.where(strip.usable, (strip.samples - expected) / scale, 0.0)
        slow, seen = (gaussian_filter(one, (_SLOW, _SLOW / strip.step)) for one in (residuals, usable))
        residuals = np.where(strip.usable, residuals - slow / np.maximum(seen, 1e-9), 0)
        number = max(float(usable.sum()), 1.0)
        variance = max(float((residuals**2).sum()) / number, 1e-300)
        covariance = autocovariance(residuals, strip.usable)
        along, across = covariance[: round(_LAGS) + 1, 0], covariance[0, : round(_LAGS / strip.step) + 1]
        together = math.prod(2 * sum_to_first_zero(lags / max(lags[0], 1e-300)) for lags in (along, across))
        skewness = float((residuals**3).sum()) / number / variance**1.5
        area = together * strip.step
        kappa = 1 / max(_EDGE * together, 1.0)
        return cls(variance, kappa, area, skewness)

    def contrast_to_noise(self, template: EdgeTemplate) -> float:
        """Return the contrast over the noise of the mean over a square of 10 × 10 px on the brighter side."""
        level = max(template.left, template.right)
        return abs(template.left - template.right) / (level * math.sqrt(self.variance * self.area) / _SIDE)


@dataclass(frozen=True, eq=False)
class Walk:
    """The posterior of a random walk.

    `mean`: mean on each normal, shape (normal,); `sd`: standard deviation on each normal, shape (normal,); `draws`:
    paths drawn from it, shape (draw, normal).
    """

    mean: Float[np.ndarray, " normal"]
    sd: Float[np.ndarray, " normal"]
    draws: Float[np.ndarray, "draw normal"]


def walk(
    table: Table, candidates: Candidates, drift: float, *, draws: int = 0, random: np.random.Generator | None = None
) -> Walk:
    """Return the posterior of a path that changes by N(0, drift²) from one normal to the next, by forward–backward.

    `table` has the log-likelihood of equally spaced candidates on each normal, but for a constant on each. With a
    `drift` below half their spacing the path could hardly move. `draws` is the number of paths to draw, by `random`.
    """
    likelihood = np.exp(table - table.max(axis=1, keepdims=True))
    kernel = np.exp(-0.5 * (np.subtract.outer(candidates, candidates) / drift) ** 2)
    kernel /= kernel.sum(axis=1, keepdims=True)
    forward = np.empty_like(likelihood)
    message = np.ones(len(candidates))
    for i, row in enumerate(likelihood):
        message = message * row + 1e-300
        forward[i] = message / message.sum()
        message = forward[i] @ kernel
    backward, message = np.empty_like(likelihood), np.ones(len(candidates))
    for i in range(len(likelihood) - 1, -1, -1):
        backward[i] = message
        message = kernel @ (message * likelihood[i])
        message /= message.sum() or 1.0
    posterior = forward * backward
    posterior /= posterior.sum(axis=1, keepdims=True)
    mean = posterior @ candidates
    sd = np.sqrt(np.maximum(posterior @ candidates**2 - mean**2, 0.0))
    drawn = _drawn(forward, kernel, draws, random) if random is not None else np.empty((0, len(mean)), dtype=int)
    return Walk(mean, sd, candidates[drawn])


def _drawn(
    forward: Table, kernel: Float[np.ndarray, "candidate candidate"], number: int, random: np.random.Generator
) -> Int[np.ndarray, "draw normal"]:
    """Return candidates on paths drawn from the last normal to the first."""
    out = np.empty((number, len(forward)), dtype=int)
    uniform = random.random((len(forward), number))
    weights = np.broadcast_to(forward[-1], (number, forward.shape[1]))
    for i in range(len(forward) - 1, -1, -1):
        total = np.cumsum(weights, axis=1)
        out[:, i] = (total < uniform[i][:, None] * total[:, -1:]).sum(axis=1)
        if i:
            weights = forward[i - 1] * kernel[:, out[:, i]].T
    return out


def _require_intensity(picture: GreyValues) -> None:
    """Refuse grey values below 0 where linear intensity is meant."""
    least = float(picture.values[picture.usable].min(initial=math.inf))
    if least < 0:
        remedy = "Undo the logarithm (scale: log10 or dB), or use method `erf`."
        raise unfit("intensity of the scan", f"{least:.6g}", "linear intensity, 0 or above", remedy)


def _require_speckle(skewness: float, sd: float) -> None:
    """Refuse values that scatter, over their mean, symmetrically or downwards, as no intensity of speckle does."""
    if skewness < _SYMMETRIC * sd:
        what = "grey values of the scan do not scatter like the intensity of speckle: skewness over relative sd"
        remedy = "Undo the logarithm of a display scan (scale: log10 or dB); for a camera use method `erf`."
        raise unfit(what, f"{skewness / sd:.2g}", "about 2, as linear intensity has; logarithms are below 0", remedy)


def _columns(picture: GreyValues, strip: Strip) -> Int[np.ndarray, "normal place"]:
    """Return the column of the picture in which each sample lies, of those outside the nearest one."""
    at = strip.course.at(np.broadcast_to(strip.places, strip.samples.shape))[..., 0] / picture.stretch[0]
    return np.asarray(np.clip(at.round().astype(int), 0, picture.values.shape[1] - 1))


def _walk(table: Table, places: Candidates, drift: float, closed: bool, draws: int) -> Walk:
    """Return the path, of a closed one without the overlap that makes its ends meet."""
    random = np.random.default_rng(_SEED) if draws else None
    if not closed:
        return walk(table, places, drift, draws=draws, random=random)
    over = min(_OVERLAP, len(table))
    path = walk(np.concatenate([table[-over:], table, table[:over]]), places, drift, draws=draws, random=random)
    inner = slice(over, over + len(table))
    return Walk(path.mean[inner], path.sd[inner], path.draws[:, inner])


def _scatter(path: Walk, counted: Normals) -> Scatter:
    apart = (path.draws - path.mean)[:, counted]
    lags = min(apart.shape[1] - 1, _LONGEST)
    products = np.array([(apart[:, : apart.shape[1] - k] * apart[:, k:]).mean() for k in range(lags + 1)])
    if not products[0] > 0:
        return Scatter(float(path.sd[counted].mean()), LEAST_LENGTH)
    return Scatter(math.sqrt(products[0]), max(sum_to_first_zero(products / products[0]), LEAST_LENGTH))
