"""What a picture must show of an edge: each number against its limit, and the refusal of an edge that misses one."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.errors import InvalidInput
from strandline.imaging.edge_errors import EdgeErrors

__all__ = ["FEWEST", "EdgeCheck", "edge_checks", "require_edge"]

FEWEST = 30
"""Fewest points of an edge."""
LEAST_CONTRAST = 2.0
"""Smallest contrast to noise."""
AT_LIMIT = 0.02
"""Largest share of an edge at the limit of the strip."""
BLUR = 1 / 3
"""Largest blur, as a share of the smallest radius of the edge."""
AT_LIMIT_REFUSED = "edge at the limit of the strip around the path"
NEAR = 1.5
"""Factor from the limit within which a number is worth a warning."""


@dataclass(frozen=True)
class EdgeCheck:
    """One number of an edge and its limit.

    Args:
        name: What the number is, in a word or two.
        value: The number.
        limit: Its limit: the largest value of a share, the smallest one of any other number.
        shown: The number in words.
        expected: The limit in words.
        share: Whether the number is a share that should be small.
        refusal: What a message says was refused.
        remedy: What to do about it.
    """

    name: str
    value: float
    limit: float
    shown: str
    expected: str
    share: bool
    refusal: str
    remedy: str

    @property
    def verdict(self) -> str:
        """``refused`` beyond the limit, ``warned`` within a factor of 1.5 of it, ``fine`` elsewhere."""
        if not (self.value <= self.limit if self.share else self.value >= self.limit):
            return "refused"
        near = self.value > self.limit / NEAR if self.share else self.value < NEAR * self.limit
        return "warned" if near else "fine"


def edge_checks(points: int, errors: EdgeErrors, *, unit: float) -> tuple[EdgeCheck, ...]:
    """Return what the picture shows of an edge, each number with its limit.

    Args:
        points: Number of points that are left after trimming and exclusion.
        errors: Errors of these points.
        unit: Length of the smaller side of a pixel in the unit of the errors.
    """
    blur, radius = errors.blur / unit, errors.radius / unit
    return (
        EdgeCheck(
            "points",
            float(points),
            float(FEWEST),
            str(points),
            f"at least {FEWEST}, one per pixel",
            share=False,
            refusal="number of points of the edge",
            remedy="Extend the path, exclude less, or use a picture with smaller pixels.",
        ),
        EdgeCheck(
            "contrast over noise",
            errors.contrast_to_noise,
            LEAST_CONTRAST,
            f"{errors.contrast_to_noise:.3g}",
            f"at least {LEAST_CONTRAST:g}",
            share=False,
            refusal="contrast over noise at the edge",
            remedy="Check that the path follows the edge, average several frames, or write `edge: path`.",
        ),
        EdgeCheck(
            "at the limit of the strip",
            errors.limit_share,
            AT_LIMIT,
            f"{100 * errors.limit_share:.1f} % of it",
            f"at most {100 * AT_LIMIT:g} %",
            share=True,
            refusal=AT_LIMIT_REFUSED,
            remedy="Put the path closer to the edge there, or end it before a place without an edge.",
        ),
        EdgeCheck(
            "blur",
            blur / radius,
            BLUR,
            f"{blur:.3g} px where the smallest radius is {radius:.3g} px",
            "at most a third of the smallest radius",
            share=True,
            refusal="blur of the edge",
            remedy="Use a sharper picture, or leave the sharpest bends out.",
        ),
    )


def require_edge(
    points: int, errors: EdgeErrors, *, unit: float, limit_at: Float[np.ndarray, " 2"] | None = None
) -> None:
    """Refuse an edge of which the picture says too little.

    Args:
        points: Number of points that are left after trimming and exclusion.
        errors: Errors of these points.
        unit: Length of the smaller side of a pixel in the unit of the errors.
        limit_at: Pixel in the middle of the longest stretch at the limit of the strip, for the message.

    Raises:
        InvalidInput: Fewer than 30 points; contrast to noise below 2; more than 2 % of the edge at the limit of the
            strip; or a blur above a third of the smallest radius.
    """
    for one in edge_checks(points, errors, unit=unit):
        if one.verdict == "refused":
            value = points if one.name == "points" else one.shown
            if one.refusal == AT_LIMIT_REFUSED and limit_at is not None:
                value = f"{one.shown}, most of all near ({limit_at[0]:.0f}, {limit_at[1]:.0f}) px"
            raise InvalidInput(one.refusal, value=value, expected=one.expected, remedy=one.remedy)
