"""Pictures of a known outline: as a camera sees it, and as an OCT B-scan.

Outlines are in pixel coordinates: x to the right, y down, the centre of the top left pixel at (0, 0).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter

from strandline.models.biofilm.mesh.outline import Outline

Line, Corners = Float[np.ndarray, "point 2"], Float[np.ndarray, "corner 2"]
Picture = Float[np.ndarray, "row column"]
Shape = tuple[int, int]
"""Rows and columns of a picture."""
PIXEL = 0.005
"""Side of a pixel, mm: the arch of 1.4 mm is 280 pixels long."""
_LINES = 16
"""Lines per row of pixels on which covered lengths are exact."""


@dataclass(frozen=True)
class Camera:
    """A camera: a step, blurred by a Gaussian (sd in px), with white noise, over whose sd the contrast is given.

    The light falls by a share from the left to the right.
    """

    blur: float = 1.5
    contrast_to_noise: float = 10.0
    light: float = 0.1

    def __call__(self, polygon: Corners, shape: Shape, random: np.random.Generator) -> Picture:
        """Return a picture of a bright region: 0.2 outside, 1.2 inside, at the left."""
        clean = gaussian_filter(0.2 + covered(polygon, shape), self.blur, mode="nearest")
        clean *= 1.0 - self.light * np.arange(shape[1]) / shape[1]
        return clean + random.standard_normal(shape) / self.contrast_to_noise


@dataclass(frozen=True)
class Scan:
    """An OCT B-scan: exponential speckle of scatterers that reflect more inside of the region.

    The field is Gaussian white noise, as strong as the square root of the reflectivity, convolved with a Gaussian of
    standard deviation w; the correlation of the intensity at distance r is exp(-r²/2w²).

    `contrast` is the reflectivity inside over that outside, dB, `speckle` w in px; light falls to 1/e at a `depth` in
    the region, px. Shadows have their middles over a range of shares of the region's width, where a share `shade` of
    the light is left; `floor` is the intensity of the detector's noise, over that outside, which is not shadowed.
    """

    contrast: float = 10.0
    speckle: float = 1.2
    shadows: int = 3
    over: tuple[float, float] = (0.2, 0.7)
    depth: float = 150.0
    shade: float = 0.25
    floor: float = 0.0

    def __call__(self, polygon: Corners, shape: Shape, random: np.random.Generator) -> Picture:
        """Return linear intensity, with a mean of 1 outside of the region."""
        share = covered(polygon, shape)
        reflects = 1 + (10 ** (self.contrast / 10) - 1) * share
        reflects *= np.exp(-np.cumsum(share, axis=0) / self.depth) * self._gain(polygon, shape, random)
        power = np.abs(self._field(np.sqrt(reflects), random)) ** 2
        if self.floor:
            power += self.floor * np.abs(self._field(np.ones(shape), random)) ** 2
        return power

    def _gain(self, polygon: Corners, shape: Shape, random: np.random.Generator) -> Float[np.ndarray, " column"]:
        """Return the light left in each column: Gaussian shadows, 4 to 8 px wide (sd)."""
        left, right = polygon[:, 0].min(), polygon[:, 0].max()
        low, high = (left + share * (right - left) for share in self.over)
        gain, x = np.ones(shape[1]), np.arange(shape[1])
        for middle in random.uniform(low, high, self.shadows):
            width = random.uniform(4.0, 8.0)
            gain *= 1 - (1 - self.shade) * np.exp(-0.5 * ((x - middle) / width) ** 2)
        return gain

    def _field(self, amplitude: Picture, random: np.random.Generator) -> Picture:
        white = amplitude * (random.standard_normal((2, *amplitude.shape)) * np.sqrt(0.5))
        real, imaginary = (gaussian_filter(part, self.speckle, mode="reflect") for part in white)
        return np.asarray((real + 1j * imaginary) * np.sqrt(4 * np.pi) * self.speckle)


def arch(shape: Shape, random: np.random.Generator) -> tuple[Line, Corners]:
    """Return an arch like the biofilm's in pixel coordinates, from the left to the right, and the region under it.

    Its shear (sd 0.1), its height (sd 5 %) and its position within a pixel are random.
    """
    shear, height = 0.1 * random.standard_normal(), 0.05 * random.standard_normal()
    return shaped(shape, shear, height, moved=(random.uniform(-0.5, 0.5), random.uniform(-0.5, 0.5)))


def shaped(
    shape: Shape, shear: float, height: float, *, moved: tuple[float, float] = (0.0, 0.0)
) -> tuple[Line, Corners]:
    """Return the arch of this shear and this relative change of height, moved to the right and down, px."""
    points = np.array(Outline(nodes=400).interface().points)
    points[:, 0] += shear * points[:, 1]
    points[:, 1] *= 1 + height
    points /= PIXEL
    middle = 0.5 * (points[:, 0].min() + points[:, 0].max())
    x = points[:, 0] - middle + 0.5 * shape[1] + moved[0]
    y = shape[0] - 20.5 - points[:, 1] + moved[1]
    line = _fine(np.stack([x, y], axis=1))
    return line, np.concatenate([line, [[line[-1, 0], shape[0] + 40], [line[0, 0], shape[0] + 40]]])


def clicks(line: Line, random: np.random.Generator) -> Float[np.ndarray, "click 2"]:
    """Return points along a line as a person clicks on 12 of them, off by 2.5 pixels (sd) in x and in y."""
    places = np.linspace(0, len(line) - 1, 12).round().astype(int)
    return line[places] + 2.5 * random.standard_normal((12, 2))


def covered(polygon: Corners, shape: Shape) -> Picture:
    """Return the share of each pixel that a polygon covers: exact along lines, 16 of them a row of pixels."""
    ends = np.roll(polygon, -1, axis=0)
    columns = np.arange(shape[1]) + 0.5
    share = np.zeros(shape)
    for line in range(shape[0] * _LINES):
        y = (line + 0.5) / _LINES - 0.5
        spans = (polygon[:, 1] > y) != (ends[:, 1] > y)
        a, b = polygon[spans], ends[spans]
        x = np.sort(a[:, 0] + (y - a[:, 1]) * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1]))
        signs = np.where(np.arange(len(x)) % 2 == 0, 1.0, -1.0)
        share[line // _LINES] += signs @ np.clip(columns - x[:, None], 0.0, 1.0)
    return share / _LINES


def _fine(points: Line) -> Line:
    """Return a line through the points with nodes a tenth of a pixel apart."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return np.asarray(CubicSpline(arc, points)(np.linspace(0.0, arc[-1], 10 * round(arc[-1]))))
