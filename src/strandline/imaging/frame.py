"""Pixel coordinates ↔ coordinates of the model, in mm; and where fixed parts of one picture are found in another.

The set-up of both pictures is the same but for a shift and a rotation. The grey values of the second one are fitted to
those of the first by least squares, with a gain and an offset of the light, in pictures that are first blurred a lot
and then less and less (Baker and Matthews, Int. J. Comput. Vis. 56, 2004, sec. 2). The errors follow from the
residuals, whose neighbours count as one as far as they are alike.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from scipy.fft import irfft2, rfft2
from scipy.ndimage import gaussian_filter, map_coordinates, spline_filter

from strandline.foundations import number, numbers, unfit
from strandline.imaging.edges.strip import covered_by

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
LEAST = 1e-3
"""Least intensity whose logarithm counts, in medians of the picture."""
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
        turned = (points - centre) * stretch @ _turn(np.deg2rad(self.rotation))
        return np.asarray((turned + self.shift) / stretch + centre)


def registered(
    first: Float[np.ndarray, "row column"],
    second: Float[np.ndarray, "other_row other_column"],
    fixed: Sequence[Float[np.ndarray, "_ 2"]],
    *,
    pixel: tuple[float, float] = (1.0, 1.0),
    speckle: bool = False,
) -> Registration:
    """Return where the fixed regions of the first picture are in the second.

    Args:
        first: Grey values [row, column].
        second: Grey values of another picture with pixels of the same size.
        fixed: Polygons in pixel coordinates of the first picture; their contents do not move with the specimen.
        pixel: Width and height of a pixel, in any unit.
        speckle: Whether the grey values are intensities of speckle, whose noise grows with them; then the logarithms
            of the blurred pictures are compared.

    Raises:
        InvalidInput: The regions hold too few pixels, leave the second picture, or do not look alike in both.
    """
    inside = np.zeros(first.shape, dtype=bool)
    for polygon in fixed:
        inside |= covered_by(np.asarray(polygon, float), first.shape)
    if inside.sum() < FEWEST:
        found, expected = f"{int(inside.sum())} pixels", f"at least {FEWEST} pixels that do not move with the specimen"
        raise unfit("fixed regions of the picture", found, expected, "Mark a larger region.")
    stretch = np.array(pixel) / min(pixel)
    fit = _Fit(inside, stretch)
    for blur in BLURS:
        across = tuple(blur / stretch[::-1])
        blurred = [gaussian_filter(np.nan_to_num(one), across, mode="nearest") for one in (first, second)]
        if speckle:  # a logarithm is as uncertain where it is bright as where it is dark
            blurred = [np.log(np.maximum(one, LEAST * float(np.median(one)))) for one in blurred]
        fit.improve(*blurred)
    return fit.result()


def _positive(information: Float[np.ndarray, "3 3"], prior: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """Return the symmetric part of a matrix, without directions in which it is negative in units of the prior."""
    root = np.sqrt(np.diag(prior))
    values, vectors = np.linalg.eigh(0.5 * (information + information.T) / np.outer(root, root))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T * np.outer(root, root))


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

    def improve(self, first: Float[np.ndarray, "row column"], second: Float[np.ndarray, "rows columns"]) -> None:
        """Take Gauss–Newton steps until they are small, from pictures blurred alike.

        With slopes J₁ and J₂ of the two pictures, whose noise is independent, J₁ᵀJ₂ is free of it on average, while
        their mean J, which turns residuals into steps, is not: the covariance is A⁻¹ (JᵀJ) A⁻¹ for A = J₁ᵀJ₂.
        """
        prior = np.diag(np.array([SHIFT, SHIFT, np.deg2rad(ROTATION)]) ** -2.0)
        bent = [spline_filter(one) for one in (first, second)]
        target, fixed_slopes, _ = self._sampled(bent[0], np.zeros(3))
        for _ in range(STEPS):
            found, slopes, seen = self._sampled(bent[1], self.x)
            if seen.sum() < FEWEST:
                remedy = "Mark what both pictures show, or leave `registration` out."
                what = "pixels of the fixed regions in the other picture"
                raise unfit(what, int(seen.sum()), f"at least {FEWEST}", remedy)
            light = np.stack([found, np.ones(len(found))], axis=1)[seen]
            (gain, level), *_ = np.linalg.lstsq(light, target[seen], rcond=None)
            residual = np.where(seen, target - gain * found - level, 0.0)
            # the light is fitted too: take its part out of the slopes
            pair = (fixed_slopes[seen], gain * slopes[seen])
            both = [one - light @ np.linalg.lstsq(light, one, rcond=None)[0] for one in pair]
            J, variance = 0.5 * (both[0] + both[1]), self._variance(residual) / max(int(seen.sum()), 1)
            variance = max(variance, 1e-300)
            scatter = J.T @ J / variance + prior
            step = np.linalg.solve(scatter, J.T @ residual[seen] / variance - prior @ self.x)
            self.x = self.x + step
            if np.abs(step[:2]).max() < 1e-4 and abs(step[2]) < 1e-6:
                break
        inverse = np.linalg.inv(_positive(both[0].T @ both[1] / variance, prior) + prior)
        self.covariance = inverse @ scatter @ inverse
        self.correlation = float(np.corrcoef(target[seen], found[seen])[0, 1]) if np.ptp(found[seen]) > 0 else 0.0

    def _sampled(
        self, bent: Float[np.ndarray, "row column"], x: Float[np.ndarray, " 3"]
    ) -> tuple[Float[np.ndarray, " pixel"], Float[np.ndarray, "pixel 3"], Bool[np.ndarray, " pixel"]]:
        """Return a picture at the places of the fixed pixels, its slopes by shift and rotation, and which lie in it.

        The picture is given by the coefficients of its cubic spline, the motion `x` as shift, px, and rotation, rad.
        """
        turned = (self.pixels - self.centre) * self.stretch @ _turn(float(x[2]))
        places = (turned + x[:2]) / self.stretch + self.centre
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
        grid = np.zeros(2 * np.array(self.inside.shape))
        grid[: self.inside.shape[0], : self.inside.shape[1]][self.inside] = residual
        products = irfft2(np.abs(rfft2(grid)) ** 2, grid.shape)
        total, reach = float(products[0, 0]), _NEIGHBOURS + 1
        if total <= 0:
            return 0.0
        near = np.roll(products, (reach - 1, reach - 1), (0, 1))[: 2 * reach - 1, : 2 * reach - 1]
        return float(np.maximum(near, 0.0).sum())

    def result(self) -> Registration:
        """Return the registration; refuse regions that do not look alike."""
        if not self.correlation >= ALIKE:
            what, expected = "fixed regions of the two pictures", f"at least {ALIKE}: the same things, seen alike"
            remedy = "Mark as fixed what does not move, and leave out what does; or leave `registration` out."
            raise unfit(what, f"a correlation of {self.correlation:.2f}", expected, remedy)
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


SIGN_X = {"right": 1.0, "left": -1.0}
SIGN_Y = {"up": -1.0, "down": 1.0}
"""Direction of an axis of the model in the picture → its sign; y of pixels points down."""


@dataclass(frozen=True)
class Frame:
    """Where the model lies in a picture.

    A point m of the model, in mm, appears at the pixel origin + S R(rotation) m / pixel: R turns from the model's x
    axis towards its y axis, and S = diag(±1, ±1) points the axes as `x` and `y` say.

    Args:
        origin: Pixel (x, y) of the model's (0, 0); the centre of the top left pixel is (0, 0), y points down.
        pixel: Size of a pixel along x and along y, mm.
        x: Direction of the model's x axis in the picture, ``right`` or ``left``, before the rotation.
        y: Direction of its y axis, ``up`` or ``down``, before the rotation.
        rotation: Angle by which the model is turned in the picture, degrees, from its x axis towards its y axis.

    Raises:
        InvalidInput: A number that is not finite, or out of its range.
    """

    origin: tuple[float, float]
    pixel: tuple[float, float]
    x: Literal["right", "left"] = "right"
    y: Literal["up", "down"] = "up"
    rotation: float = 0.0

    def __post_init__(self) -> None:
        numbers(self.origin, 2, "origin", "the pixel [x, y] of the model's (0, 0)")
        number(self.rotation, "rotation", "an angle from -360 to 360 degrees", -360.0, 360.0)
        for size in numbers(self.pixel, 2, "pixel", "two lengths in mm"):
            number(size, "pixel", "two lengths above 0, in mm", low=5e-324)

    @property
    def mirrors(self) -> bool:
        """Whether a curve that turns from x to y in pixels turns from y to x in the model."""
        return SIGN_X[self.x] * SIGN_Y[self.y] < 0

    def moved(self, registration: Registration) -> "Frame":
        """Return the frame of another picture, in which the fixed parts of this one were found."""
        x, y = registration(np.array([self.origin]))[0]
        turn = -registration.rotation if self.mirrors else registration.rotation
        return replace(self, origin=(float(x), float(y)), rotation=self.rotation + turn)

    @property
    def matrix(self) -> Float[np.ndarray, "2 2"]:
        """Matrix that turns differences of pixel coordinates into differences of model coordinates, mm."""
        angle = math.radians(self.rotation)
        back = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        return back * [SIGN_X[self.x] * self.pixel[0], SIGN_Y[self.y] * self.pixel[1]]

    def to_mm(self, points: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, "point 2"]:
        """Return pixel coordinates (x, y), shape (point, 2), as points of the model, mm."""
        return np.asarray((points - np.array(self.origin)) @ self.matrix.T)

    def to_pixels(self, points: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, "point 2"]:
        """Return points of the model, mm, shape (point, 2), as pixel coordinates (x, y); the inverse of `to_mm`."""
        return np.asarray(points @ np.linalg.inv(self.matrix).T + np.array(self.origin))
