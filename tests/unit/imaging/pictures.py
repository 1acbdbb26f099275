"""Small pictures with edges whose place is known exactly."""

import numpy as np
from scipy.special import ndtr


def grid(shape):
    """Return x and y of the pixel centres."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    return x, y


def straight(shape=(60, 140), *, at=30.3, slope=0.0, blur=1.5):
    """Return a picture that is bright (3) below the line y = at + slope x and dark (1) above it."""
    x, y = grid(shape)
    return 1.0 + 2.0 * ndtr((y - at - slope * x) / np.hypot(1.0, slope) / blur)


def disc(shape=(120, 120), *, radius=40.0, blur=1.0, stretch=1.0):
    """Return a bright disc about the middle; rows are `stretch` times as high as columns are wide."""
    x, y = grid(shape)
    r = np.hypot(x - 0.5 * (shape[1] - 1), stretch * (y - 0.5 * (shape[0] - 1)))
    return ndtr((radius - r) / blur)


def circle(number=12, *, radius=41.0, middle=(59.5, 59.5), stretch=1.0):
    """Return points on a circle, clockwise as the picture is seen, in pixel coordinates."""
    angle = 2 * np.pi * np.arange(number) / number
    return np.stack([middle[0] + radius * np.cos(angle), middle[1] + radius * np.sin(angle) / stretch], axis=1)
