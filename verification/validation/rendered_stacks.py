"""Stacks of a known surface, as a microscope sees it: blurred by a Gaussian, with white noise.

Lengths are in mm; voxels need not be cubes.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter

from strandline.imaging import Stack


@dataclass(frozen=True)
class Blob:
    """An ellipsoid with half axes along x, y and z, and waves of bumps, whose height is a share of the axes."""

    centre: tuple[float, float, float]
    axes: tuple[float, float, float]
    bumps: float = 0.0
    waves: int = 3

    def distances(self, points: Float[np.ndarray, "*point 3"]) -> Float[np.ndarray, "*point"]:
        """Return signed distances of points near the surface, above 0 outside, to second order in the distance."""
        step = 1e-4 * min(self.axes)
        here = self._implicit(points)
        slopes = [
            (self._implicit(points + step * axis) - self._implicit(points - step * axis)) / (2 * step)
            for axis in np.eye(3)
        ]
        return np.asarray(here / np.maximum(np.sqrt(sum(slope**2 for slope in slopes)), 1e-12))

    def _implicit(self, points: Float[np.ndarray, "*point 3"]) -> Float[np.ndarray, "*point"]:
        x, y, z = np.moveaxis((points - np.array(self.centre)) / np.array(self.axes), -1, 0)
        r = np.sqrt(x**2 + y**2 + z**2) + 1e-12
        if not self.bumps:
            return np.asarray(r - 1)
        k = self.waves
        wave = np.sin(k * x / r) * np.cos(k * y / r) + np.sin(k * z / r) * np.cos(k * x / r)
        return np.asarray(r - 1 - self.bumps * wave)


@dataclass(frozen=True)
class Microscope:
    """A microscope: size of a voxel and sd of the blur along x, y and z, mm, and numbers of planes, rows and columns.

    The contrast is given over the standard deviation of the noise of a voxel; the solid is `bright`, or dark.
    """

    voxel: tuple[float, float, float]
    shape: tuple[int, int, int]
    blur: tuple[float, float, float]
    contrast_to_noise: float = 10.0
    bright: bool = True

    def clean(self, blob: Blob) -> Float[np.ndarray, "z row column"]:
        """Return the stack without noise: 0 outside, 1 inside."""
        z, y, x = np.indices(self.shape, dtype=np.float32)
        cover = np.empty(self.shape)
        for k in range(self.shape[0]):
            points = np.stack([x[k], y[k], z[k]], axis=-1).astype(float) * self.voxel
            cover[k] = self._cover(blob, points)
        sigmas = np.array(self.blur[::-1]) / np.array(self.voxel[::-1])
        inside = gaussian_filter(cover, np.sqrt(np.maximum(sigmas**2 - 1 / 12, 0.0)), mode="nearest")
        return inside if self.bright else 1 - inside

    def __call__(self, blob: Blob, random: np.random.Generator) -> Stack:
        return self.with_noise(self.clean(blob), random)

    def with_noise(self, clean: Float[np.ndarray, "z row column"], random: np.random.Generator) -> Stack:
        noise = random.standard_normal(self.shape) / self.contrast_to_noise
        return Stack(clean + noise, self.voxel, "rendered", "0" * 64)

    def _cover(self, blob: Blob, points: Float[np.ndarray, "*point 3"]) -> Float[np.ndarray, "*point"]:
        """Return the part of each voxel inside the blob: of a plane face, through a voxel of the same variance."""
        distance = blob.distances(points)
        side = math.prod(self.voxel) ** (1 / 3)
        return np.asarray(np.clip(0.5 - distance / side, 0.0, 1.0))
