"""How far blur moves a curved surface, and what is left of it.

A Gaussian blur of covariance Σ moves the half level of a step with the curvatures K towards its hollow side by
½ tr(KΣ) over the tangent plane: w²/R for a sphere of radius R and a blur w (Bouma et al. 2005).
"""

import numpy as np
from jaxtyping import Float
from scipy.optimize import nnls
from scipy.spatial import cKDTree

__all__ = ["blur_along_axes", "dislocation", "shape_operators"]

_NEIGHBOURS, _LEAST = 24, 8.0
"""Points over which the curvature is taken, and the least distance over which they spread, in sides of a voxel."""
_SAME_SIDE = 0.2
"""Cosine of the normals from which a neighbour belongs to the same part of the surface."""


def shape_operators(
    points: Float[np.ndarray, "point 3"], normals: Float[np.ndarray, "point 3"]
) -> Float[np.ndarray, "point 3 3"]:
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


def blur_along_axes(
    blurs: Float[np.ndarray, " point"], normals: Float[np.ndarray, "point 3"]
) -> Float[np.ndarray, " 3"]:
    """Return the variance of the blur along x, y and z from that along each normal."""
    directions = np.concatenate([normals**2, 0.1 * np.eye(3) * np.sqrt(len(normals))])
    seen = np.concatenate([blurs**2, np.full(3, 0.1 * np.sqrt(len(normals)) * float(np.median(blurs**2)))])
    return np.asarray(nnls(directions, seen)[0])


def dislocation(
    operators: Float[np.ndarray, "point 3 3"], variances: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, " point"]:
    """Return ½ tr(KΣ): how far blur has moved each point inwards."""
    return np.asarray(0.5 * np.einsum("pii,i->p", operators, variances))


def frames(normals: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point 2 3"]:
    """Return two unit tangents at each point, at right angles."""
    axis = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    first = np.cross(normals, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(normals, first)], axis=1)
