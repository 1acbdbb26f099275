"""Where the fixed parts of one picture are found in another of the same set-up: a shift and a rotation.

The grey values of the second picture are fitted to those of the first by least squares, with a gain and an offset of
the light, in pictures that are first blurred a lot and then less and less (Baker and Matthews, Int. J. Comput. Vis. 56,
2004, sec. 2). The errors follow from the residuals, whose neighbours count as one as far as they are alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter, map_coordinates, spline_filter

from strandline.errors import InvalidInput
from strandline.imaging.strip import covered_by

__all__ = ["Registration", "registered"]

BLURS = (12.0, 6.0, 3.0, 1.5)
"""Standard deviations of the Gaussians that blur both pictures, px, one after the other."""
STEPS = 30
SHIFT, ROTATION = 5.0, 1.0
"""Standard deviations of the prior of shift, px, and rotation, degrees: what keeps a direction that no structure of the
fixed regions tells."""
ALIKE = 0.5
"""Least correlation of the fixed regions in both pictures."""
FEWEST = 100
"""Fewest pixels of the fixed regions."""
MOST = 20_000
"""Most pixels that are compared: of larger regions every second, third, … row and column."""
_NEIGHBOURS = 12
"""Distance up to which residuals are compared with each other, in rows and columns that are compared."""
_STEP = 0.5
"""Step of the differences that give slopes, px."""


@dataclass(frozen=True)
class Registration:
    """A point p of the fixed regions in the first picture is found at centre + shift + R (p - centre) in the second.

    Lengths are in units of the smaller side of a pixel, px.

    Args:
        centre: Mean pixel (x, y) of the fixed regions in the first picture.
        stretch: Width and height of a pixel, px.
        shift: Shift along x (right) and y (down), px.
        rotation: Angle of R in degrees, from x towards y: clockwise as the picture is seen.
        shift_sd: Standard deviation of the shift in its least certain direction, px.
        rotation_sd: Standard deviation of the rotation, degrees.
        correlation: Correlation of the grey values of the fixed regions in both pictures, blurred by 1.5 px.
    """

    centre: tuple[float, float]
    stretch: tuple[float, float]
    shift: tuple[float, float]
    rotation: float
    shift_sd: float
    rotation_sd: float
    correlation: float

    def __call__(self, points: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, "point 2"]:
        """Return where points of the first picture are in the second, in pixels, shape (point, 2)."""
        centre, stretch = np.array(self.centre), np.array(self.stretch)
        return np.asarray(
            ((points - centre) * stretch @ _turn(np.deg2rad(self.rotation)) + self.shift) / stretch + centre
        )


def registered(
    first: Float[np.ndarray, "row column"],
    second: Float[np.ndarray, "row column"],
    fixed: Sequence[Float[np.ndarray, "corner 2"]],
    *,
    pixel: tuple[float, float] = (1.0, 1.0),
) -> Registration:
    """Return where the fixed regions of the first picture are in the second.

    Args:
        first: Grey values [row, column].
        second: Grey values of another picture with pixels of the same size.
        fixed: Polygons in pixel coordinates of the first picture; their contents do not move with the specimen.
        pixel: Width and height of a pixel, in any unit.

    Raises:
        InvalidInput: The regions hold too few pixels, or do not look alike in both pictures.
    """
    inside = np.zeros(first.shape, dtype=bool)
    for polygon in fixed:
        inside |= covered_by(np.asarray(polygon, float), first.shape)
    if inside.sum() < FEWEST:
        raise InvalidInput(
            "fixed regions of the picture",
            value=f"{int(inside.sum())} pixels",
            expected=f"at least {FEWEST} pixels that do not move with the specimen",
            remedy="Mark a larger region.",
        )
    stretch = np.array(pixel) / min(pixel)
    fit = _Fit(inside, stretch)
    for blur in BLURS:
        across = tuple(blur / stretch[::-1])
        fit.improve(*(gaussian_filter(np.nan_to_num(one), across, mode="nearest") for one in (first, second)))
    return fit.result()


def _turn(angle: float) -> Float[np.ndarray, "2 2"]:
    """Return the matrix that turns rows (x, y) from x towards y."""
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


class _Fit:
    """The state of a registration: shift, px, and rotation, rad, about the middle of the fixed regions."""

    def __init__(self, inside: Bool[np.ndarray, "row column"], stretch: Float[np.ndarray, " 2"]) -> None:
        self.stretch = stretch
        self.stride = max(1, int(np.sqrt(inside.sum() / MOST)))
        self.inside = inside[:: self.stride, :: self.stride]
        rows, columns = (self.stride * one for one in np.nonzero(self.inside))
        self.pixels = np.stack([columns, rows], axis=1).astype(float)
        self.centre = self.pixels.mean(axis=0)
        self.x = np.zeros(3)
        self.correlation = 0.0
        self.covariance = np.eye(3)

    def improve(self, first: Float[np.ndarray, "row column"], second: Float[np.ndarray, "row column"]) -> None:
        """Take Gauss–Newton steps until they are small, from pictures blurred alike."""
        prior = np.diag(np.array([SHIFT, SHIFT, np.deg2rad(ROTATION)]) ** -2.0)
        target = first[:: self.stride, :: self.stride][self.inside]
        bent = spline_filter(second)
        for _ in range(STEPS):
            found, slopes, seen = self._sampled(bent)
            light = np.stack([found, np.ones(len(found))], axis=1)[seen]
            (gain, level), *_ = np.linalg.lstsq(light, target[seen], rcond=None)
            residual = np.where(seen, target - gain * found - level, 0.0)
            # the light is fitted too: take its part out of the slopes
            J = gain * slopes[seen]
            J -= light @ np.linalg.lstsq(light, J, rcond=None)[0]
            variance = max(self._variance(residual) / max(int(seen.sum()), 1), 1e-300)
            information, gradient = J.T @ J / variance, J.T @ residual[seen] / variance
            step = np.linalg.solve(information + prior, gradient - prior @ self.x)
            self.x = self.x + step
            if np.abs(step[:2]).max() < 1e-4 and abs(step[2]) < 1e-6:
                break
        self.covariance = np.linalg.inv(information + prior)
        self.correlation = float(np.corrcoef(target[seen], found[seen])[0, 1]) if np.ptp(found[seen]) > 0 else 0.0

    def _sampled(
        self, bent: Float[np.ndarray, "row column"]
    ) -> tuple[Float[np.ndarray, " pixel"], Float[np.ndarray, "pixel 3"], Bool[np.ndarray, " pixel"]]:
        """Return a picture at the places of the fixed pixels, its slopes by shift and rotation, and which lie in it.

        Args:
            bent: Coefficients of the cubic spline through its grey values.
        """
        turned = (self.pixels - self.centre) * self.stretch @ _turn(float(self.x[2]))
        places = (turned + self.x[:2]) / self.stretch + self.centre
        at = places.T[::-1]
        value, *ends = (
            map_coordinates(bent, at + np.array(move)[:, None], order=3, mode="nearest", prefilter=False)
            for move in ((0, 0), (_STEP, 0), (-_STEP, 0), (0, _STEP), (0, -_STEP))
        )
        down, right = (ends[0] - ends[1]) / (2 * _STEP), (ends[2] - ends[3]) / (2 * _STEP)
        down, right = down / self.stretch[1], right / self.stretch[0]
        around = down * turned[:, 0] - right * turned[:, 1]
        seen = (places >= 0).all(axis=1) & (places <= np.array(bent.shape[::-1]) - 1).all(axis=1)
        return value, np.stack([right, down, around], axis=1), seen

    def _variance(self, residual: Float[np.ndarray, " pixel"]) -> float:
        """Return the variance of a residual times the number of neighbours that count as one."""
        grid = np.zeros(self.inside.shape)
        grid[self.inside] = residual
        total, alike = float((grid**2).sum()), 1.0
        for down in range(_NEIGHBOURS + 1):
            for right in range(-_NEIGHBOURS if down else 1, _NEIGHBOURS + 1):
                shifted = np.roll(grid, (down, right), (0, 1))
                alike += 2 * max(float((grid * shifted).sum()) / total, 0.0) if total > 0 else 0.0
        return total * alike

    def result(self) -> Registration:
        """Return the registration; refuse regions that do not look alike."""
        if not self.correlation >= ALIKE:
            raise InvalidInput(
                "fixed regions of the two pictures",
                value=f"a correlation of {self.correlation:.2f}",
                expected=f"at least {ALIKE}: the same things, seen alike",
                remedy="Mark as fixed what does not move, and leave out what does; or leave `registration` out.",
            )
        shift, rotation = np.linalg.eigvalsh(self.covariance[:2, :2]).max(), self.covariance[2, 2]
        return Registration(
            (float(self.centre[0]), float(self.centre[1])),
            (float(self.stretch[0]), float(self.stretch[1])),
            (float(self.x[0]), float(self.x[1])),
            float(np.rad2deg(self.x[2])),
            float(np.sqrt(shift)),
            float(np.rad2deg(np.sqrt(rotation))),
            self.correlation,
        )
