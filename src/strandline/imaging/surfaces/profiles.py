"""Grey values along the normals of a surface: where they cross the half level, and the errors that they show.

A Gaussian blur of covariance Σ moves the half level of a step with the curvatures K towards its hollow side by
½ tr(KΣ) over the tangent plane: w²/R for a sphere of radius R and a blur w (Bouma et al. 2005).

Noise η of the smoothed stack moves a point along its normal by η over the slope of the grey value there. The sd of η
and its correlation along the surface are seen on both sides of the surface, where there is nothing but noise.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import map_coordinates
from scipy.optimize import nnls
from scipy.spatial import cKDTree

from strandline.foundations import unfit
from strandline.imaging.surfaces.mesh import Field, Mesh, PerPoint, Points

Values = Float[np.ndarray, "point place"]
Triple = tuple[float, float, float]
REACH, STEP = 7.0, 0.5
PLATEAU = 4.0
"""Distance from the surface beyond which a side has its own grey value, in sides of a voxel."""
_ROUNDS = 10
"""Rounds of averaging over neighbouring points of the grey values of both sides and of the slope between them."""
_FAR = 3.0
"""Largest distance of a crossing."""
_GRADIENT = 1.5
"""Half the distance over which a gradient is taken."""
_NEIGHBOURS, _LEAST = 24, 8.0
"""Points over which the curvature is taken, and the least distance over which they spread, in sides of a voxel."""
_SAME_SIDE = 0.2
"""Cosine of the normals from which a neighbour belongs to the same part of the surface."""


@dataclass(frozen=True, eq=False)
class Profiles:
    """Profiles across a surface; lengths in sides of a voxel.

    `offsets`: where each profile crosses the half level, outwards; `found`: which profiles do; `inside`, `outside`:
    grey value of the solid near each point, averaged over its neighbours, and of its surroundings; `slopes`: fall of
    the grey value per length at the crossing, in the contrast of the two sides, averaged likewise.
    """

    offsets: PerPoint
    found: Bool[np.ndarray, " point"]
    inside: PerPoint
    outside: PerPoint
    slopes: PerPoint

    @property
    def blurs(self) -> PerPoint:
        """Standard deviation of the Gaussian whose step has this slope."""
        return np.asarray(1 / (np.maximum(self.slopes, 1e-3) * math.sqrt(2 * math.pi)))

    def of(self, used: Int[np.ndarray, " used"]) -> "Profiles":
        """Return the profiles of some of the points."""
        return Profiles(*(one[used] for one in (self.offsets, self.found, self.inside, self.outside, self.slopes)))


def sampled(
    values: Float[np.ndarray, "z row column"] | np.ndarray, field: Field, places: Float[np.ndarray, "*place 3"]
) -> tuple[Float[np.ndarray, "*place"], Bool[np.ndarray, "*place"]]:
    """Return grey values between the voxels, and which of the places lie in the stack."""
    within = np.asarray(((places >= 0) & (places <= field.extent)).all(axis=-1))
    at = np.moveaxis((places / field.stretch)[..., ::-1], -1, 0)
    return map_coordinates(values, at, order=1, mode="nearest", output=np.float64), within


def normals_of(field: Field, points: Points, *, bright: bool) -> Points:
    """Return unit normals out of the solid, against the gradient of a bright one."""
    moves = _GRADIENT * np.eye(3)
    ahead, behind = (sampled(field.values, field, points[:, None] + side * moves)[0] for side in (1.0, -1.0))
    gradient = (behind - ahead) if bright else (ahead - behind)
    return np.asarray(gradient / np.maximum(np.linalg.norm(gradient, axis=1), 1e-30)[:, None])


def profiles_at(field: Field, mesh: Mesh, normals: Points, *, level: float) -> Profiles:
    """Return the profiles along the unit normals, out of the solid, at the points of a surface.

    `level` is the grey value half way between the two parts of the whole stack.
    """
    u = np.arange(-REACH, REACH + 0.5 * STEP, STEP)
    values, within = sampled(field.values, field, mesh.points[:, None] + u[:, None] * normals[:, None])
    up = float(np.median(values[:, 0]) - np.median(values[:, -1])) > 0
    solid = (values > level) == up
    inside, outside = (_side(mesh, u, values, within & same, side) for same, side in ((solid, -1.0), (~solid, 1.0)))
    contrast = inside - outside
    relative = (values - outside[:, None]) / np.where(np.abs(contrast) > 0, contrast, math.inf)[:, None] - 0.5
    crosses = (relative[:, :-1] > 0) & (relative[:, 1:] <= 0) & within[:, :-1] & within[:, 1:]
    fall = np.where(crosses, relative[:, :-1] - relative[:, 1:], 1.0)
    at = np.where(crosses, u[:-1] + STEP * relative[:, :-1] / fall, math.inf)
    nearest = np.argmin(np.abs(at), axis=1)
    rows = np.arange(len(at))
    found = np.abs(at[rows, nearest]) <= _FAR
    slopes = mesh.averaged(fall[rows, nearest] / STEP, found.astype(float), rounds=_ROUNDS)
    return Profiles(np.where(found, at[rows, nearest], 0.0), found, inside, outside, slopes)


def _side(
    mesh: Mesh, u: Float[np.ndarray, " place"], values: Values, usable: Bool[np.ndarray, "point place"], side: float
) -> PerPoint:
    """Return the grey value on one side of the surface: up to where the profile meets another part of it."""
    order = np.argsort(side * u)
    beyond = order[side * u[order] >= 0.5 * PLATEAU]
    reached = np.logical_and.accumulate(usable[:, beyond], axis=1) & (side * u[beyond] >= PLATEAU)
    number = reached.sum(axis=1).astype(float)
    means = (values[:, beyond] * reached).sum(axis=1) / np.maximum(number, 1.0)
    overall = float(np.median(means[number > 0])) if (number > 0).any() else 0.0
    return mesh.averaged(np.where(number > 0, means, overall), number + 1e-6, rounds=_ROUNDS)


def shape_operators(points: Points, normals: Points) -> Float[np.ndarray, "point 3 3"]:
    """Return the curvatures of a surface as tensors in its tangent planes, positive where it is convex.

    They are those of a quadric through the points nearby, by least squares.
    """
    number = min(_NEIGHBOURS, len(points))
    tree = cKDTree(points)
    distance, near = tree.query(points, number)
    if float(np.median(distance[:, -1])) < _LEAST:
        number = min(int(number * (_LEAST / max(float(np.median(distance[:, -1])), 1e-9)) ** 2), len(points))
        distance, near = tree.query(points, number)
    tangents = frames(normals)
    away = points[near] - points[:, None]
    x, y = (np.einsum("pnk,pk->pn", away, tangents[:, k]) for k in (0, 1))
    height = np.einsum("pnk,pk->pn", away, normals)
    cosine = np.einsum("pnk,pk->pn", normals[near], normals)
    reach = np.maximum(distance[:, -1:], 1e-9)
    weight = np.where(cosine > _SAME_SIDE, np.exp(-2 * (distance / reach) ** 2), 0.0)
    x, y = x / reach, y / reach
    basis = np.stack([np.ones_like(x), x, y, 0.5 * x * x, x * y, 0.5 * y * y], axis=2)
    normal = np.einsum("pni,pn,pnj->pij", basis, weight, basis) + 1e-9 * np.eye(6)
    fitted = np.linalg.solve(normal, np.einsum("pni,pn,pn->pi", basis, weight, height)[..., None])[..., 0]
    xx, xy, yy = (-fitted[:, 3:] / reach**2).T
    plane = np.stack([np.stack([xx, xy], axis=1), np.stack([xy, yy], axis=1)], axis=1)
    return np.asarray(np.einsum("pai,pab,pbj->pij", tangents, plane, tangents))


def blur_along_axes(blurs: PerPoint, normals: Points) -> Float[np.ndarray, " 3"]:
    """Return the variance of the blur along x, y and z from that along each normal."""
    directions = np.concatenate([normals**2, 0.1 * np.eye(3) * np.sqrt(len(normals))])
    seen = np.concatenate([blurs**2, np.full(3, 0.1 * np.sqrt(len(normals)) * float(np.median(blurs**2)))])
    return np.asarray(nnls(directions, seen)[0])


def dislocation(operators: Float[np.ndarray, "point 3 3"], variances: Float[np.ndarray, " 3"]) -> PerPoint:
    """Return ½ tr(KΣ): how far blur has moved each point inwards."""
    return np.asarray(0.5 * np.einsum("pii,i->p", operators, variances))


def frames(normals: Points) -> Float[np.ndarray, "point 2 3"]:
    """Return two unit tangents at each point, at right angles."""
    axis = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    first = np.cross(normals, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(normals, first)], axis=1)


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


def noise_beside(field: Field, mesh: Mesh, normals: Points, profiles: Profiles) -> Triple:
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
        found = f"no plain grey value {PLATEAU + 2 * field.sigma:.3g} voxels away from it"
        remedy = "Use a stack with smaller voxels, or one that shows more of the surroundings."
        raise unfit("room beside the surface", found, "solid and surroundings with a grey value of their own", remedy)
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
    field: Field, mesh: Mesh, profiles: Profiles, noise: Triple, moved: PerPoint, unit: float, cut: float, share: float
) -> SurfaceErrors:
    """Return the errors of the points of a surface in sides of a voxel, of which one is `unit` mm.

    `noise` comes from `noise_beside`; `moved` is how far each point was moved to put right what blur does to a curved
    surface; `cut` and `share` are the result's `open_share` and `area_share`.
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
        open_share=cut,
        area_share=share,
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
        value = f"{100 * errors.open_share:.0f} % of the solid's surface"
        advice = "Use a larger stack, or check `solid: bright` or `dark`."
        raise unfit("surface cut off by the faces of the stack", value, f"at most {100 * MOST_OPEN:g} %", advice)
    if lost > LOST:
        found, expected = f"{100 * lost:.1f} % of them", f"at most {100 * LOST:g} %"
        remedy = "Use a stack with less noise or more even light."
        raise unfit("points of the surface without an edge nearby", found, expected, remedy)
