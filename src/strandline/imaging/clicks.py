"""What a person marked in a picture: scale bar, origin, first path, regions; and the file that keeps it."""

import math
import re
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.errors import InvalidInput
from strandline.imaging.paths.first_path import FirstPath, require_inside, require_path, require_polygon

__all__ = ["Clicks", "ScaleBar"]

Point = tuple[float, float]
"""Pixel coordinates (x, y)."""
WIDEST = 1 << 31
"""Largest width and height of a picture, in pixels."""


@dataclass(frozen=True)
class ScaleBar:
    """A line of known length in a picture.

    Args:
        start: One end, in pixels.
        end: The other end, in pixels.
        length_mm: Length of the line, in mm.

    Raises:
        InvalidInput: A value that is not finite, ends that coincide, or a length that is not above 0.
    """

    start: Point
    end: Point
    length_mm: float

    def __post_init__(self) -> None:
        _require_finite((*self.start, *self.end), "scale bar")
        if not (math.isfinite(self.length_mm) and self.length_mm > 0):
            raise _refused("length of the scale bar", self.length_mm, "a number above 0, in mm")
        if self.pixels == 0:
            expected = "two ends that differ"
            raise _refused("scale bar of no length in the picture", list(self.start), expected, "Draw the bar again.")

    @property
    def pixels(self) -> float:
        """Length of the line in the picture, in pixels."""
        return math.dist(self.start, self.end)


@dataclass(frozen=True, eq=False)
class Clicks:
    """What a person marked in one picture.

    Coordinates are pixels (x, y) of the whole picture: y points down, the centre of the top left pixel is (0, 0).

    Args:
        image: File name of the picture.
        sha256: SHA-256 checksum of the picture's file, in hexadecimal.
        size: Width and height of the picture, in pixels.
        path: Rough path along the edge, in order; empty if the picture only serves to register another one to it, by
            `fixed`.
        closed: Whether the last point of the path is joined to the first.
        scale: Line of known length.
        origin: Pixel of the model's point (0, 0); it may lie outside the picture.
        exclude: Regions in which no edge is looked for, each the corners of a polygon.
        fixed: Regions that do not move between the undeformed and the deformed picture, each the corners of a polygon.

    Raises:
        InvalidInput: A checksum or size that cannot be one, a path or a region with fewer than 3 points, a path that
            crosses itself, or a point outside the picture.
    """

    image: str
    sha256: str
    size: tuple[int, int]
    path: Float[np.ndarray, "point 2"]
    closed: bool = False
    scale: ScaleBar | None = None
    origin: Point | None = None
    exclude: tuple[Float[np.ndarray, "_ 2"], ...] = ()
    fixed: tuple[Float[np.ndarray, "_ 2"], ...] = ()

    def __post_init__(self) -> None:
        if not re.fullmatch("[0-9a-f]{64}", self.sha256):
            raise _refused("checksum of the picture", self.sha256, "64 digits 0-9, a-f")
        if min(self.size) < 1 or max(self.size) > WIDEST:
            raise _refused("size of the picture", list(self.size), f"[width, height] from 1 to {WIDEST} px")
        if len(self.path) or not self.fixed:
            require_path(self.path, "the path", closed=self.closed)
            require_inside(self.path, self.size, "the path")
        if self.scale is not None:
            require_inside(np.array([self.scale.start, self.scale.end]), self.size, "scale bar")
        if self.origin is not None:
            _require_finite(self.origin, "origin")
        for kind, regions in (("exclude", self.exclude), ("fixed", self.fixed)):
            for number, corners in enumerate(regions, 1):
                require_polygon(corners, f"{kind}: region {number}")
                require_inside(corners, self.size, f"{kind}: region {number}")

    @property
    def pixel_mm(self) -> float | None:
        """Size of a square pixel from the scale bar, in mm."""
        return None if self.scale is None else self.scale.length_mm / self.scale.pixels

    @property
    def first_path(self) -> FirstPath:
        """The path, from which the search for the edge starts."""
        return FirstPath(self.path, self.closed)

    def require_picture(self, sha256: str, size: tuple[int, int]) -> None:
        """Refuse another picture than the one that was clicked on.

        Args:
            sha256: Checksum of the picture's file.
            size: Width and height of the picture, in pixels.

        Raises:
            InvalidInput: Another checksum or another size.
        """
        remedy = "Give that picture, or mark this one again: `strandline image STUDY --edit`."
        if sha256.lower() != self.sha256:
            raise _refused(
                f"the clicks on {self.image} were made on another picture than this one",
                f"SHA-256 {sha256[:12]}…",
                f"{self.sha256[:12]}…",
                remedy,
            )
        if tuple(size) != self.size:
            raise _refused(
                f"the clicks on {self.image} were made on a picture of another size",
                f"{size[0]} × {size[1]} px",
                f"{self.size[0]} × {self.size[1]} px",
                remedy,
            )


def _require_finite(values: tuple[float, ...], what: str) -> None:
    if not all(map(math.isfinite, values)):
        raise _refused(f"{what} is not finite", list(values), "finite pixel coordinates")


def _refused(what: str, value: object, expected: str, remedy: str = "Correct it, or click again.") -> InvalidInput:
    return InvalidInput(what, value=value, expected=expected, remedy=remedy)
