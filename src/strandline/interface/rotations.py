"""Rotations in the plane and in space."""

import numpy as np
from jaxtyping import Complex, Float
from scipy.spatial.transform import Rotation

__all__ = ["as_complex", "as_pairs", "rotations"]


def as_complex(points: Float[np.ndarray, "*case 2"]) -> Complex[np.ndarray, "*case"]:
    """Return points of the plane as x + iy: turning and moving many of them is several times as fast."""
    return np.asarray(np.ascontiguousarray(points).view(complex)[..., 0])


def as_pairs(points: Complex[np.ndarray, "*case"]) -> Float[np.ndarray, "*case 2"]:
    """Return points x + iy as rows (x, y)."""
    return np.ascontiguousarray(points)[..., None].view(float)


def rotations(angles: Float[np.ndarray, "run axis"]) -> Float[np.ndarray, "run xyz xyz"]:
    """Return rotation matrices: by one angle in the plane, or about each axis of space by a rotation vector.

    Args:
        angles: Angles, radians, one rotation a row.
    """
    if angles.shape[1] == 3:
        return np.asarray(Rotation.from_rotvec(angles).as_matrix())
    c, s = np.cos(angles[:, 0]), np.sin(angles[:, 0])
    return np.stack([np.stack([c, -s], axis=1), np.stack([s, c], axis=1)], axis=1)
