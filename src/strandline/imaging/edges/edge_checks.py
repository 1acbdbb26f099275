"""The errors of an edge, estimated from its picture, and what a picture and a path in it must show."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from strandline.foundations import unfit
from strandline.imaging.edges.strip import GreyValues, Located, SmoothPath
from strandline.imaging.paths import require_finite, require_inside, require_simple

LEAST_SD = 0.01
"""Smallest standard deviation of a point, px: no picture shows an edge more closely."""
_ROOM, _CROSSED = 4.0, 0.05
"""Distance from the path within which normals may not cross, px, but for this share of them."""
FEWEST = 30
"""Fewest points of an edge."""
LEAST_CONTRAST = 2.0
"""Smallest contrast to noise."""
AT_LIMIT = 0.02
"""Largest share of an edge at the limit of the strip."""
BLUR = 1 / 3
"""Largest blur, as a share of the smallest radius of the edge."""
NOISE, LIMIT = "contrast over noise", "at the limit of the strip"
REFUSALS = {
    "points": ("number of points of the edge", "Extend the path, exclude less, or use a picture with smaller pixels."),
    NOISE: (
        "contrast over noise at the edge",
        "Check that the path follows the edge, average several frames, or write `edge: path`.",
    ),
    LIMIT: (
        "edge at the limit of the strip around the path",
        "Put the path closer to the edge there, or end it before a place without an edge.",
    ),
    "blur": ("blur of the edge", "Use a sharper picture, or leave the sharpest bends out."),
}
"""Name of a check → what a message says was refused, and what to do about it."""
NEAR = 1.5
"""Factor from the limit within which a number is worth a warning."""


@dataclass(frozen=True)
class EdgeErrors:
    """Errors of the points of an edge; lengths in the unit of the pixel size, pixels if it is (1, 1).

    Args:
        sd: Standard deviation s of a point along its normal.
        length: Integral correlation length ℓ = ∫₀^∞ ρ(t) dt of these errors along the edge.
        offset: Standard deviation of a common offset of all points along their normals; never 0.
        spacing: Distance of neighbouring points along the edge.
        blur: Standard deviation of the blur across the edge.
        radius: Smallest radius of curvature of the smoothed edge.
        contrast: Grey value outside of the solid minus that inside.
        contrast_to_noise: Size of the contrast over the noise: of one pixel for methods `erf` and `contour`, of the
            mean over a square of 10 × 10 px for `path`.
        limit_share: Share of the points at the limit of the strip.
        facts: What the method estimated besides, by name, e.g. κ for speckle.
    """

    sd: float
    length: float
    offset: float
    spacing: float
    blur: float
    radius: float
    contrast: float
    contrast_to_noise: float
    limit_share: float
    facts: dict[str, float]

    @property
    def level(self) -> float:
        """The product s²ℓ: half the spectral density of the errors at low frequencies, which is what counts."""
        return self.sd**2 * self.length


def edge_errors(
    located: Located, curvatures: Float[np.ndarray, " point"], *, bias: float, side: float, unit: float, kept: int
) -> EdgeErrors:
    """Return the errors of an edge, of which some points are kept, from the curvatures 1/R at these, 1/px.

    `bias`: standard deviation of a common offset of a straight edge, in pixels; `side`: size of a pixel along the
    normals, px; `unit`: length of the px in the unit of the pixel size; `kept`: number of points that are kept.
    """
    radius = 1 / max(float(np.abs(curvatures).max(initial=0.0)), 1e-9)
    return EdgeErrors(
        sd=unit * max(located.scatter.sd, LEAST_SD),
        length=unit * located.scatter.length,
        offset=unit * offset_sd(bias * side, located.blur, curvatures),
        spacing=unit * float(np.median(np.diff(located.course.arc))),
        blur=unit * located.blur,
        radius=unit * radius,
        contrast=located.contrast,
        contrast_to_noise=located.contrast_to_noise,
        limit_share=float(located.at_limit.sum()) / max(kept, 1),
        facts=located.facts,
    )


def offset_sd(straight: float, blur: float, curvatures: Float[np.ndarray, " point"]) -> float:
    """Return the sd of a common offset: of a straight edge, and w²/2R, by which blur moves a bend of rms radius R."""
    bend = math.sqrt(float(np.mean(curvatures**2))) if len(curvatures) else 0.0
    return math.hypot(straight, 0.5 * blur**2 * bend)


@dataclass(frozen=True)
class EdgeCheck:
    """One number of an edge and its limit, by name and in words.

    The limit is the largest value of a share, which should be small, and the smallest one of any other number.
    """

    name: str
    value: float
    limit: float
    shown: str
    expected: str
    share: bool

    @property
    def verdict(self) -> str:
        """``refused`` beyond the limit, ``warned`` within a factor of 1.5 of it, ``fine`` elsewhere."""
        if not (self.value <= self.limit if self.share else self.value >= self.limit):
            return "refused"
        near = self.value > self.limit / NEAR if self.share else self.value < NEAR * self.limit
        return "warned" if near else "fine"


def edge_checks(points: int, errors: EdgeErrors, *, unit: float) -> tuple[EdgeCheck, ...]:
    """Return what the picture shows of an edge, each number with its limit.

    `points`: number of points that are left after trimming and exclusion; `errors`: errors of these points; `unit`:
    length of the smaller side of a pixel in the unit of the errors.
    """
    blur, radius = errors.blur / unit, errors.radius / unit
    ratio, share = f"{errors.contrast_to_noise:.3g}", f"{100 * errors.limit_share:.1f} % of it"
    sizes = f"{blur:.3g} px where the smallest radius is {radius:.3g} px"
    return (
        EdgeCheck("points", float(points), float(FEWEST), str(points), f"at least {FEWEST}, one per pixel", False),
        EdgeCheck(NOISE, errors.contrast_to_noise, LEAST_CONTRAST, ratio, f"at least {LEAST_CONTRAST:g}", False),
        EdgeCheck(LIMIT, errors.limit_share, AT_LIMIT, share, f"at most {100 * AT_LIMIT:g} %", True),
        EdgeCheck("blur", blur / radius, BLUR, sizes, "at most a third of the smallest radius", True),
    )


def require_edge(
    points: int, errors: EdgeErrors, *, unit: float, limit_at: Float[np.ndarray, " 2"] | None = None
) -> None:
    """Refuse an edge of which the picture says too little; see `edge_checks`.

    Fewer than 30 points; contrast to noise below 2; more than 2 % of the edge at the limit of the strip, for
    instance at the pixel `limit_at`; or a blur above a third of the smallest radius.
    """
    for one in edge_checks(points, errors, unit=unit):
        if one.verdict == "refused":
            value = points if one.name == "points" else one.shown
            if one.name == LIMIT and limit_at is not None:
                value = f"{one.shown}, most of all near ({limit_at[0]:.0f}, {limit_at[1]:.0f}) px"
            what, remedy = REFUSALS[one.name]
            raise unfit(what, value, one.expected, remedy)


def require_path(path: Float[np.ndarray, "..."], picture: GreyValues, *, closed: bool) -> None:
    """Refuse a path that is too short, leaves the picture or crosses itself; repeated points count once."""
    fewest = 3 if closed else 2
    expected = f"at least {fewest} points (x, y) that differ"
    remedy = "Give points along the edge in their order, in pixel coordinates."
    if path.ndim != 2 or path.shape[1] != 2 or not len(path):
        raise unfit("path along the edge", f"an array of shape {path.shape}", expected, remedy)
    require_finite(path, "the path")
    height, width = picture.values.shape
    require_inside(path, (width, height), "the path")
    apart = np.concatenate([[True], (np.diff(path, axis=0) != 0).any(axis=1)])
    if closed and (path[0] == path[-1]).all():
        apart[-1] = False
    if apart.sum() < fewest:
        raise unfit("path along the edge", f"{apart.sum()}", expected, remedy)
    require_simple(path[apart], "the path", closed=closed)


def require_room(course: SmoothPath) -> None:
    """Refuse a path whose normals cross close to it on more than 5 % of its length."""
    crossed = ~course.own(np.array([-_ROOM, _ROOM])).all(axis=1)
    if crossed.mean() > _CROSSED:
        what, found = "normals of the path cross", f"on {100 * crossed.mean():.0f} % of its length, within {_ROOM:g} px"
        remedy = "Smooth the path, leave out thin parts, or use a picture with smaller pixels."
        raise unfit(what, found, f"bends with radii above {_ROOM:g} px, and no other part of the path nearby", remedy)
