"""Errors of the points of a surface, estimated from the stack in which it was found.

Noise η of the smoothed stack moves a point along its normal by η over the slope of the grey value there. The sd of η
and its correlation along the surface are seen on both sides of the surface, where there is nothing but noise.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from strandline.imaging.surfaces.levels import Field
from strandline.imaging.surfaces.mesh import Mesh, PerPoint, Points
from strandline.imaging.surfaces.profiles import PLATEAU, Profiles, frames, sampled
from strandline.readers import unfit

BIAS = 0.1
"""Standard deviation of a common offset where the surface is flat, in sides of a voxel."""
LEAST_SD = 0.01
"""Smallest standard deviation of a point, in sides of a voxel: no stack shows a surface more closely."""
_LEFT = 0.3
"""Share of the correction for blur on a curved surface that is in doubt."""
_LAGS = np.arange(0.0, 7.5, 0.5)
_SILL = 5.0
"""Distance from which the noise is independent, in standard deviations of the smoothing."""
_NOTHING = 0.05
"""Correlation below which there is none."""
_SAME = 0.35
"""Largest distance of a value from its side's, in the contrast, if it is noise."""
LEAST_CONTRAST = 2.0
"""Smallest contrast to noise of a voxel."""
MOST_OPEN = 0.5
"""Largest share of the surface of the solid that the faces of the stack cut off."""
LOST = 0.02
"""Largest share of the points without a crossing of the half level nearby."""


@dataclass(frozen=True)
class SurfaceErrors:
    """Errors of the points of a surface; lengths in mm.

    Args:
        sd: Standard deviation s of a point along its normal.
        length: Correlation length ℓ of these errors along the surface, with 2πℓ² = ∬ρ.
        offset: Standard deviation of a common offset of all points along their normals; never 0.
        blur: Standard deviation of the blur across the surface, of the stack as it was read.
        contrast_to_noise: Contrast of the two sides over the noise of a voxel.
        open_share: Share of the surface of the solid in the stack that the faces of the stack cut off.
        area_share: Share of the connected part that was taken in the area of all surfaces at its level.
        facts: What was estimated besides, by name.
    """

    sd: float
    length: float
    offset: float
    blur: float
    contrast_to_noise: float
    open_share: float
    area_share: float
    facts: dict[str, float]


def noise_beside(field: Field, mesh: Mesh, normals: Points, profiles: Profiles) -> tuple[float, float, float]:
    """Return the noise on both sides of a surface, from differences along tangents of it.

    Its standard deviation in the smoothed stack, in its grey values, its correlation length ℓ there, in sides of a
    voxel, with 2πℓ² = ∬ρ along the surface, and the standard deviation of a voxel of the stack as it was read.
    """
    tangents, contrast = frames(normals), np.abs(profiles.inside - profiles.outside)
    lags, tree = _LAGS * max(field.sigma, 1.0), cKDTree(mesh.points)
    products: list[Float[np.ndarray, "pair lag"]] = []
    voxels: list[PerPoint] = []
    for side, level in ((1.0, profiles.outside), (-1.0, profiles.inside)):
        start = mesh.points + side * (PLATEAU + 2 * field.sigma) * normals
        for tangent in (tangents[:, 0], tangents[:, 1]):
            places = start[:, None] + lags[:, None] * tangent[:, None]
            values, within = sampled(field.values, field, places)
            near = tree.query(places)[1]
            away = side * ((places - mesh.points[near]) * normals[near]).sum(axis=2)
            noise = within & (away > PLATEAU + 0.5 * field.sigma)
            noise &= np.abs(values - level[:, None]) < _SAME * contrast[:, None]
            products.append(np.where(noise & noise[:, :1], 0.5 * (values - values[:, :1]) ** 2, np.nan))
        voxels.append(_of_voxels(field, start, level, _SAME * contrast))
    pairs = np.concatenate(products)
    known = np.isfinite(pairs).sum(axis=0)
    gamma = np.nansum(pairs, axis=0) / np.maximum(known, 1)
    far = (lags >= _SILL * field.sigma) & (known > 0)
    sill = float(np.average(gamma[far], weights=known[far])) if far.any() else float(gamma.max())
    rho = 1 - gamma / max(sill, 1e-300)
    below = np.flatnonzero(rho < _NOTHING)
    rho[below[0] if below.size else len(rho) :] = 0.0
    integral = float(np.trapezoid(rho * lags, lags))
    squares = np.concatenate(voxels) ** 2
    if not (known[1:].any() and np.isfinite(squares).any()):
        raise unfit(
            "room beside the surface",
            f"no plain grey value {PLATEAU + 2 * field.sigma:.3g} voxels away from it",
            "solid and surroundings with a grey value of their own",
            "Use a stack with smaller voxels, or one that shows more of the surroundings.",
        )
    variance = float(np.nanmean(squares))
    return math.sqrt(sill), math.sqrt(integral), math.sqrt(variance)


def _of_voxels(field: Field, places: Points, level: PerPoint, far: np.ndarray) -> PerPoint:
    """Return the grey values of single voxels about the smoothed ones; NaN where there is more than noise."""
    at = np.rint(places / field.stretch).astype(int)
    size = np.array(field.values.shape[::-1])
    within = ((at >= 0) & (at < size)).all(axis=1)
    x, y, z = np.where(within[:, None], at, 0).T
    smooth = field.values[z, y, x]
    return np.where(within & (np.abs(smooth - level) < far), field.raw[z, y, x] - smooth, np.nan)


def surface_errors(
    field: Field,
    mesh: Mesh,
    profiles: Profiles,
    noise: tuple[float, float, float],
    moved: PerPoint,
    *,
    unit: float,
    open_share: float,
    area_share: float,
) -> SurfaceErrors:
    """Return the errors of the points of a surface in sides of a voxel, of which one is `unit` mm.

    `noise` comes from `noise_beside`; `moved` is how far each point was moved to put right what blur does to a curved
    surface.
    """
    noise_sd, noise_length, of_voxel = noise
    contrast = np.abs(profiles.inside - profiles.outside)
    sds = noise_sd / np.maximum(contrast * profiles.slopes, 1e-300)
    sd = math.sqrt(float(np.mean(sds**2)))
    blur = float(np.sqrt(np.mean(profiles.blurs**2)))
    area = float(mesh.areas.mean())
    bend = float(np.mean(moved)) / max(blur**2, 1e-9)
    chord = abs(bend) * area / (2 * math.sqrt(3))
    offset = math.sqrt(BIAS**2 + _LEFT**2 * float(np.mean(moved**2)) + chord**2)
    return SurfaceErrors(
        sd=unit * max(sd, LEAST_SD),
        length=unit * noise_length,
        offset=unit * offset,
        blur=unit * math.sqrt(max(blur**2 - field.sigma**2, 0.0)),
        contrast_to_noise=float(np.median(contrast)) / of_voxel if of_voxel > 0 else math.inf,
        open_share=open_share,
        area_share=area_share,
        facts={
            "smoothing": unit * field.sigma,
            "noise": of_voxel,
            "inside": float(np.median(profiles.inside)),
            "outside": float(np.median(profiles.outside)),
            "blur_correction": unit * float(np.sqrt(np.mean(moved**2))),
            "chord": unit * chord,
        },
    )


def require_surface(errors: SurfaceErrors, lost: float) -> None:
    """Refuse a surface of which the stack says too little.

    Contrast to noise below 2, a solid cut off by the faces of the stack over most of its surface, or more than 2 % of
    the points, the share `lost`, without a crossing of the half level nearby.
    """
    if not errors.contrast_to_noise >= LEAST_CONTRAST:
        found, expected = f"{errors.contrast_to_noise:.3g}", f"at least {LEAST_CONTRAST:g}"
        remedy = "Use a stack with less noise, e.g. the mean of several."
        raise unfit("contrast over noise at the surface", found, expected, remedy)
    if errors.open_share > MOST_OPEN:
        raise unfit(
            "surface cut off by the faces of the stack",
            f"{100 * errors.open_share:.0f} % of the solid's surface",
            f"at most {100 * MOST_OPEN:g} %",
            "Use a larger stack, or check `solid: bright` or `dark`.",
        )
    if lost > LOST:
        found, expected = f"{100 * lost:.1f} % of them", f"at most {100 * LOST:g} %"
        remedy = "Use a stack with less noise or more even light."
        raise unfit("points of the surface without an edge nearby", found, expected, remedy)
