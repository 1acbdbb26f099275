"""Pixel coordinates ↔ coordinates of the model, in mm."""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from strandline.imaging.registration import Registration
from strandline.readers import number, numbers

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
