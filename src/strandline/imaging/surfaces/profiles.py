"""Grey values along the normals of a surface, where they cross the half level, and how far blur moves that.

A Gaussian blur of covariance Σ moves the half level of a step with the curvatures K towards its hollow side by
½ tr(KΣ) over the tangent plane: w²/R for a sphere of radius R and a blur w (Bouma et al. 2005).
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import map_coordinates
from scipy.optimize import nnls
from scipy.spatial import cKDTree

from strandline.imaging.surfaces.levels import Field
from strandline.imaging.surfaces.mesh import Mesh, PerPoint, Points

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

    Args:
        offsets: Where each profile crosses the half level, outwards, shape (point,).
        found: Which profiles do.
        inside: Grey value of the solid near each point, averaged over its neighbours.
        outside: Grey value of its surroundings.
        slopes: Fall of the grey value per length at the crossing, in the contrast of the two sides, averaged likewise.
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
    mesh: Mesh,
    u: Float[np.ndarray, " place"],
    values: Float[np.ndarray, "point place"],
    usable: Bool[np.ndarray, "point place"],
    side: float,
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
