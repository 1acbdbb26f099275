"""Ways to find an edge, and how a study names one; here those that look at each normal by itself.

`ErfStep`, for cameras and microscopes: on each normal the grey value at distance u is lo + (hi - lo) Φ((u - u₀)/w) plus
noise, with u₀, lo and hi of its own and one blur w for all. All are fitted at once by Gauss–Newton steps; w couples the
3 × 3 systems of the normals and is eliminated last. `HalfLevel`, for clean pictures: the contour at the half level
between the two sides.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d
from scipy.special import ndtr

from strandline.foundations import InvalidInput, keys_of, lookup, unfit
from strandline.imaging.edges.markov_path import MarkovPath
from strandline.imaging.edges.profile_and_noise import PLATEAU, learnt_template, noise_covariance, scatter_of
from strandline.imaging.edges.strip import (
    EdgeMethod,
    GreyValues,
    Located,
    Normals,
    PerNormal,
    PerPlace,
    Samples,
    Scatter,
    SmoothPath,
    Strip,
    strip_along,
)

Basis = Float[np.ndarray, "place column"]
_STEPS = 12
"""Gauss–Newton steps."""
_BLURS = (0.3, 6.0)
"""Smallest and largest blur w that is fitted."""
_PLATEAU = 2
"""Fewest usable samples on each side of a step."""
_TOGETHER = 3.0
"""Standard deviation, in normals, over which the strip is averaged to find a first step on each normal."""


@dataclass(frozen=True, eq=False)
class FittedSteps:
    """Fitted steps.

    `places`: u₀ on each normal, shape (normal,); `low`: grey value before the step (u < u₀), shape (normal,); `high`:
    grey value after it, shape (normal,); `width`: blur w; `found`: normals with enough usable samples on both sides.
    """

    places: PerNormal
    low: PerNormal
    high: PerNormal
    width: float
    found: Normals


@dataclass(frozen=True)
class ErfStep:
    """Find the edge as a blurred step on each normal.

    Args:
        reach: Half the length of the normals, px.
        step: Distance of the samples, px.
        bias: Standard deviation of a common offset where the edge is straight, px.
        passes: Number of passes.
    """

    reach: float = 8.0
    step: float = 0.5
    bias: float = 0.1
    passes: int = 2

    def locate(self, picture: GreyValues, course: SmoothPath, counted: Normals | None) -> Located:
        """Return the edge near a course; see `EdgeMethod`."""
        strip = strip_along(picture, course, reach=self.reach, step=self.step)
        steps = fit_steps(strip, tolerance=0.02 if counted is None else 1e-5)
        jumps = steps.high - steps.low
        contrast = float(np.median(jumps[steps.found])) if steps.found.any() else 0.0
        noise, scatter = math.nan, Scatter()
        if counted is not None and (counted & steps.found).any():
            phi = _phi(strip, steps.places, steps.width)
            residuals = strip.samples - np.asarray(steps.low[:, None] + jumps[:, None] * phi)
            influence = _influence(strip, steps, contrast)
            noise, scatter = _noise_of(strip, steps.places, counted & steps.found, residuals, *influence)
        sds = scatter.sd * abs(contrast) / np.maximum(np.abs(jumps), 0.01 * abs(contrast) + 1e-300)
        at_limit = steps.found & (np.abs(steps.places) > self.reach - 1.0)
        edge = strip, steps.places, sds, steps.found, at_limit, scatter
        to_noise = abs(contrast) / noise if noise != 0 else math.inf
        return Located(*edge, steps.width, contrast, to_noise, {"noise": noise})


def fit_steps(strip: Strip, *, tolerance: float = 1e-5) -> FittedSteps:
    """Return the blurred steps that fit the strip best in the sense of least squares.

    `strip`: the samples; `tolerance`: root mean square of the last change of u₀, and last change of w, in px.
    """
    places, found = _first_places(strip)
    weights = strip.usable * found[:, None].astype(float)
    width, damping = 1.0, np.full(len(places), 1e-9)
    low, high, left = _levels(strip, weights, places, width)
    for _ in range(_STEPS):
        change, wider = _newton(strip, weights, places, low, high, width, damping)
        trial = np.clip(places + np.clip(change, -1.0, 1.0), strip.places[0], strip.places[-1])
        wide = float(np.clip(width * math.exp(np.clip(wider / width, -0.5, 0.5)), *_BLURS))
        before = left if wide == width else _levels(strip, weights, places, wide)[2]
        better = _levels(strip, weights, trial, wide)[2] <= before
        damping = np.where(better, np.maximum(0.1 * damping, 1e-12), np.clip(100 * damping, 1e-3, 1e6))
        moved = np.where(better, trial, places)
        last = max(float(np.sqrt(np.mean((moved - places) ** 2))), abs(wide - width))
        places, width = moved, wide
        low, high, left = _levels(strip, weights, places, width)
        if last < tolerance:
            break
    return FittedSteps(places, low, high, width, found)


def _first_places(strip: Strip) -> tuple[PerNormal, Normals]:
    """Return the sharp step on each normal that explains most, in the direction that most normals have."""
    weights = strip.usable.astype(float)
    mode = "wrap" if strip.course.closed else "nearest"
    total = gaussian_filter1d(weights * strip.samples, _TOGETHER, axis=0, mode=mode)
    count = gaussian_filter1d(weights, _TOGETHER, axis=0, mode=mode)
    before, number = np.cumsum(total, axis=1)[:, :-1], np.cumsum(count, axis=1)[:, :-1]
    after, rest = total.sum(axis=1)[:, None] - before, count.sum(axis=1)[:, None] - number
    jump = after / np.maximum(rest, 1e-9) - before / np.maximum(number, 1e-9)
    gain = number * rest / np.maximum(number + rest, 1e-9) * jump**2
    own = np.cumsum(weights, axis=1)
    enough = (own[:, :-1] >= _PLATEAU) & (own[:, -1:] - own[:, :-1] >= _PLATEAU)
    up = (np.where(enough, gain, 0.0) * np.sign(jump)).sum() > 0
    gain = np.where(enough & ((jump > 0) == up), gain, -1.0)
    return strip.places[:-1][gain.argmax(axis=1)] + 0.5 * strip.step, enough.any(axis=1)


def _levels(strip: Strip, weights: Samples, places: PerNormal, width: float) -> tuple[PerNormal, PerNormal, PerNormal]:
    """Return the best lo and hi for given u₀ and w, and the sum of squares that is left."""
    phi, z = _phi(strip, places, width), strip.samples
    one, up, two = weights.sum(axis=1), (weights * phi).sum(axis=1), (weights * phi**2).sum(axis=1)
    mean, with_phi = (weights * z).sum(axis=1), (weights * z * phi).sum(axis=1)
    determinant = np.maximum(one * two - up**2, 1e-9 * np.maximum(one, 1.0) ** 2)
    jump = (one * with_phi - up * mean) / determinant
    low = (mean - jump * up) / np.maximum(one, 1.0)
    left = (weights * (z - low[:, None] - jump[:, None] * phi) ** 2).sum(axis=1)
    return low, low + jump, left


def _newton(
    strip: Strip, weights: Samples, places: PerNormal, low: PerNormal, high: PerNormal, width: float, damping: PerNormal
) -> tuple[PerNormal, float]:
    """Return the Gauss–Newton changes of u₀ and of w."""
    phi, slope, scaled = _phi(strip, places, width), *_slopes(strip, places, width)
    jump = (high - low)[:, None]
    residuals = weights * (strip.samples - low[:, None] - jump * phi)
    wide = -jump * slope * scaled
    columns = np.stack([-jump * slope, 1 - phi, phi], axis=1) * weights[:, None]
    products = columns @ np.stack([-jump * slope, 1 - phi, phi, residuals, wide], axis=2)
    H, right = products[:, :, :3], products[:, :, 3:]
    diagonal = np.einsum("naa->na", H)
    diagonal *= 1 + damping[:, None]
    diagonal += 1e-12
    solved = np.linalg.solve(H, right)
    curvature = float((weights * wide**2).sum() - (right[..., 1] * solved[..., 1]).sum())
    force = float((residuals * wide).sum() - (right[..., 1] * solved[..., 0]).sum())
    wider = force / curvature if curvature > 0 else 0.0
    return solved[:, 0, 0] - wider * solved[:, 0, 1], wider


def _phi(strip: Strip, places: PerNormal, width: float) -> Samples:
    return np.asarray(ndtr((strip.places - places[:, None]) / width))


def _slopes(strip: Strip, places: PerNormal, width: float) -> tuple[Samples, Samples]:
    """Return the derivative of Φ((u - u₀)/w) with respect to u, and (u - u₀)/w."""
    scaled = (strip.places - places[:, None]) / width
    return np.exp(-0.5 * scaled**2) / (math.sqrt(2 * math.pi) * width), scaled


def _influence(strip: Strip, steps: FittedSteps, contrast: float) -> tuple[Basis, PerPlace]:
    """Return what noise does to a typical normal: its basis, and the change of u₀ per unit of noise."""
    middle = np.array([float(np.median(steps.places[steps.found]))])
    phi, (slope, _) = _phi(strip, middle, steps.width)[0], _slopes(strip, middle, steps.width)
    basis = np.stack([-(contrast or 1e-300) * slope[0], 1 - phi, phi], axis=1)
    return basis, np.asarray(np.linalg.pinv(basis)[0])


_ALONG = 5.0
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

    def locate(self, picture: GreyValues, course: SmoothPath, counted: Normals | None) -> Located:
        """Return the edge near a course; see `EdgeMethod`."""
        strip = strip_along(picture, course, reach=self.reach, step=self.step)
        right, left = _sides(strip)
        contrast = float(np.median(left - right))
        offsets, found = self._crossings(strip, right, left, up=contrast > 0)
        scale = np.where(np.abs(left - right) > 0, left - right, math.inf)
        relative = np.where(strip.usable, (strip.samples - right[:, None]) / scale[:, None], 0.0)
        normalised = Strip(relative, strip.usable & found[:, None], strip.places, course)
        template, _ = learnt_template(normalised, offsets)
        noise, scatter = math.nan, Scatter()
        if counted is not None and (counted & found).any():
            expected = template.at(strip.places - offsets[:, None])
            residuals = (relative - expected) * (left - right)[:, None]
            profile, sigma = template.at(strip.places), self.smooth / strip.step
            kernel = gaussian_filter1d((np.abs(strip.places) < 0.5 * strip.step).astype(float), sigma)
            smooth = gaussian_filter1d(profile, sigma)
            slope = float(np.gradient(smooth, strip.places)[len(smooth) // 2])
            # what alignment takes out of residuals, and the change of the edge per unit of noise in each sample
            basis, row = np.gradient(profile, strip.places)[:, None], -kernel / (contrast * slope or math.inf)
            noise, scatter = _noise_of(strip, offsets, counted & found, residuals, basis, row)
        at_limit = found & (np.abs(offsets) > self.reach - 1.0)
        edge = strip, offsets, np.full(len(offsets), scatter.sd), found, at_limit, scatter
        to_noise = abs(contrast) / noise if noise != 0 else math.inf
        return Located(*edge, template.blur, contrast, to_noise, {"noise": noise})

    def _crossings(self, strip: Strip, right: PerNormal, left: PerNormal, *, up: bool) -> tuple[PerNormal, Normals]:
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


def _sides(strip: Strip) -> tuple[PerNormal, PerNormal]:
    """Return the grey values on the right and on the left of the path, smoothed along it."""
    mode, out = "wrap" if strip.course.closed else "nearest", []
    for side in (-1.0, 1.0):
        there = (side * strip.places >= PLATEAU[0]) & (side * strip.places <= PLATEAU[1])
        weight = gaussian_filter1d(strip.usable[:, there].sum(axis=1).astype(float), _ALONG, mode=mode)
        total = gaussian_filter1d(strip.samples[:, there].sum(axis=1), _ALONG, mode=mode)
        out.append(total / np.maximum(weight, 1e-9))
    return out[0], out[1]


def _noise_of(
    strip: Strip, offsets: PerNormal, kept: Normals, left: Samples, basis: Basis, row: PerPlace
) -> tuple[float, Scatter]:
    """Return the noise of a pixel, and the random errors of the points that are kept, from what a fit has left."""
    weights = strip.usable & kept[:, None]
    covariance = noise_covariance(np.where(weights, left, 0.0), weights, basis)
    noise = math.sqrt(max(float(covariance[0, 0]), 0.0) / strip.kept)
    return noise, scatter_of(np.where(kept, offsets, math.nan), covariance, row)


EDGES: dict[str, Any] = {"erf": ErfStep(), "path": MarkovPath(), "contour": HalfLevel()}
"""Ways to find an edge by their names: erf for cameras, path for speckle in linear intensity, contour for clean
pictures."""
EXAMPLE = "erf, or {method: my_package.edges:Steepest, options: {reach: 5.5}}"


def edge_method(given: object, place: str = "method to find an edge") -> EdgeMethod:
    """Return the way to find an edge that a study names.

    Args:
        given: Name of an entry of `EDGES` or ``module:name``; or `method`, such a name, with the `options` of its
            class; or an `EdgeMethod`.
        place: Place in the study file, for messages.

    Raises:
        InvalidInput: There is no such method, it takes no such options, or it lacks parts of an `EdgeMethod`.
    """
    name: Any = given
    options: Any = {}
    if isinstance(given, Mapping):
        keys_of(given, ("method", "options"), place, EXAMPLE)
        name, options = given.get("method"), given.get("options") or {}
        place = f"{place}.method"
    if not isinstance(options, Mapping):
        raise unfit(place, options, "options with values, e.g. {reach: 5}")
    if name is None or isinstance(name, bool | int | float | list | Mapping):
        raise unfit(place, name, f"the name of a method, e.g. {EXAMPLE}")
    found = lookup(EDGES, name, place) if isinstance(name, str) else name
    return _sound(_made(found, name, options, place), name, place)


def _made(found: Any, name: object, options: Mapping[str, Any], place: str) -> Any:
    if not isinstance(found, type):
        if options:
            raise unfit(place, f"{name} with options", "options for a class only", "Remove the options.")
        return found
    try:
        return found(**options)
    except InvalidInput:
        raise
    except Exception as error:
        found, why = f"{name} with options {dict(options)}", str(error).partition("\n")[0]
        raise unfit(place, found, f"options it takes ({why})") from None


def _sound(found: Any, name: object, place: str) -> EdgeMethod:
    """Refuse what is no method: a part is missing, no offset is in doubt, or it never looks."""
    if not isinstance(found, EdgeMethod):
        missing = [part for part in ("bias", "passes", "locate") if not hasattr(found, part)]
        raise unfit(place, f"{name}, without {', '.join(missing)}", "an EdgeMethod: bias, passes and locate")
    if not (found.bias > 0 and found.passes >= 1):
        value = f"{name} with bias {found.bias} and passes {found.passes}"
        raise unfit(place, value, "a bias above 0, since no edge is free of an offset, and at least one pass")
    return found
