"""Small pictures with edges whose place is known exactly."""

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr


def grid(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return x and y of the pixel centres."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    return x, y


def straight(
    shape: tuple[int, int] = (60, 140), *, at: float = 30.3, slope: float = 0.0, blur: float = 1.5
) -> Float[np.ndarray, "row column"]:
    """Return a picture that is bright (3) below the line y = at + slope x and dark (1) above it."""
    x, y = grid(shape)
    return 1.0 + 2.0 * ndtr((y - at - slope * x) / np.hypot(1.0, slope) / blur)


def steep(slope: float, shape: tuple[int, int] = (120, 100), *, blur: float = 1.0) -> Float[np.ndarray, "row column"]:
    """Return a picture that is bright (10) right of the line x = 50 + slope (y - 60) and dark (1) left of it."""
    x, y = grid(shape)
    return 1.0 + 9.0 * ndtr((x - 50 - slope * (y - 60)) / np.hypot(1.0, slope) / blur)


def shadow(at: float, columns: int = 100, *, width: float = 5.0, shade: float = 0.25) -> Float[np.ndarray, " column"]:
    """Return the light left in each column beside a Gaussian shadow."""
    return 1 - (1 - shade) * np.exp(-0.5 * ((np.arange(columns) - at) / width) ** 2)


def disc(
    shape: tuple[int, int] = (120, 120), *, radius: float = 40.0, blur: float = 1.0, stretch: float = 1.0
) -> Float[np.ndarray, "row column"]:
    """Return a bright disc about the middle; rows are `stretch` times as high as columns are wide."""
    x, y = grid(shape)
    r = np.hypot(x - 0.5 * (shape[1] - 1), stretch * (y - 0.5 * (shape[0] - 1)))
    return ndtr((radius - r) / blur)


def circle(
    number: int = 12, *, radius: float = 41.0, middle: tuple[float, float] = (59.5, 59.5), stretch: float = 1.0
) -> Float[np.ndarray, "point 2"]:
    """Return points on a circle, clockwise as the picture is seen, in pixel coordinates."""
    angle = 2 * np.pi * np.arange(number) / number
    return np.stack([middle[0] + radius * np.cos(angle), middle[1] + radius * np.sin(angle) / stretch], axis=1)


def speckle(
    mean: Float[np.ndarray, "row column"], random: np.random.Generator, *, looks: int = 1
) -> Float[np.ndarray, "row column"]:
    """Return uncorrelated speckle of this mean intensity."""
    return mean * random.gamma(looks, 1 / looks, mean.shape)
