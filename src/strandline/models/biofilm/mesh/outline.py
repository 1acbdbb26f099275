"""The channel, the outline of the biofilm in it, and where the foot of the solid is held on the floor."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import CubicSpline

from strandline.foundations import unfit
from strandline.interface import Interface

SIDES = ("left", "right")
OUTLETS = ("horizontal", "traction_free")
TOPS = ("no_slip", "slip", "symmetry")
ON_WALL = 1e-9

Pairs = tuple[tuple[float, float], ...]
CONTROL_POINTS = (
    (0.540, 0.000), (0.582, 0.085), (0.582, 0.190), (0.598, 0.304), (0.672, 0.408), (0.803, 0.465), (0.950, 0.465),
    (1.092, 0.428), (1.202, 0.347), (1.244, 0.238), (1.254, 0.133), (1.302, 0.052), (1.391, 0.000),
)  # fmt: skip
"""Points (x, y) in mm from the upstream to the downstream foot; the outline of the study is not published in text."""
NODES = 66
"""Interface nodes of the study (its n_in)."""
LEAST = 4
"""Fewest nodes of a body."""
CLAMPED = "clamped of the biofilm model"


@dataclass(frozen=True)
class Channel:
    """A channel [0, length] × [0, height], mm.

    Args:
        length: length, mm.
        height: height, mm.
        inlet: the side where the fluid enters with a parabolic profile; it leaves on the other side.
        outlet: ``horizontal``: no vertical velocity, as in the study; ``traction_free``: open.
        top: ``no_slip``: a wall; ``slip``: a wall without friction; ``symmetry``: the middle of a channel of twice this
            height. The last two are the same equations: no vertical velocity, no shear stress.
    """

    length: float = 2.0
    height: float = 1.0
    inlet: str = "left"
    outlet: str = "horizontal"
    top: str = "no_slip"

    def __repr__(self) -> str:
        """Return the fields; a top wall that is no exception stays out, for the sake of earlier fingerprints."""
        top = "" if self.top == "no_slip" else f", top={self.top!r}"
        names = ("length", "height", "inlet", "outlet")
        return f"Channel({', '.join(f'{name}={getattr(self, name)!r}' for name in names)}{top})"

    @property
    def is_frictionless(self) -> bool:
        """Whether the top exerts no shear stress."""
        return self.top != "no_slip"

    def __post_init__(self) -> None:
        for name in ("length", "height"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise unfit(f"{name} of the channel", value, "a length in mm above 0")
        for name, choices in (("inlet", SIDES), ("outlet", OUTLETS), ("top", TOPS)):
            if getattr(self, name) not in choices:
                raise unfit(f"{name} of the channel", getattr(self, name), f"one of {', '.join(choices)}")


def check_outline(outline: Interface, channel: Channel) -> None:
    """Refuse an outline that does not bound a solid on the channel's floor.

    It starts on the floor or on the left end of the channel, ends on the floor or on the right end (both on the floor:
    a bump; neither: a layer), runs from left to right, stays inside the channel elsewhere and does not cross itself.
    Two neighbours on the floor between the ends separate two bodies.
    """
    outline.require_simple()
    first, last = outline.points[0], outline.points[-1]
    if first[0] > last[0]:
        raise unfit("direction of the outline", _place(first), "points from left to right", "Reverse their order.")
    for point, wall in ((first, 0.0), (last, channel.length)):
        on_floor = abs(point[1]) < ON_WALL and 0 < point[0] < channel.length
        on_end = abs(point[0] - wall) < ON_WALL and 0 < point[1] < channel.height
        if not (on_floor or on_end):
            place = f"a point on the floor y = 0 or on the channel's end x = {wall:g}"
            raise unfit("end of the outline", _place(point), place, "Move or add the end point.")
    check_inside(outline.points, channel)


def check_inside(points: Sequence[tuple[float, float]] | Float[np.ndarray, "point 2"], channel: Channel) -> None:
    """Refuse an outline, or control points of one, that leaves the channel between its ends."""
    inner = np.asarray(points, float)[1:-1]
    inner = inner[~_between_bodies(inner, channel)]
    inside = (inner[:, 0] > 0) & (inner[:, 0] < channel.length) & (inner[:, 1] > 0) & (inner[:, 1] < channel.height)
    if not inside.all():
        expected = f"points inside [0, {channel.length:g}] × [0, {channel.height:g}] mm"
        remedy = "Correct the point or the channel. A spline may overshoot: add points, or `spline: false`."
        remedy += " Two bodies need two neighbouring points on the floor between them."
        raise unfit("outline outside the channel", _place(inner[np.argmin(inside)]), expected, remedy)


def _between_bodies(inner: Float[np.ndarray, "point 2"], channel: Channel) -> Bool[np.ndarray, " point"]:
    """Return which points are the end of one body and the start of the next: two neighbours on the floor."""
    on_floor = (np.abs(inner[:, 1]) < ON_WALL) & (inner[:, 0] > 0) & (inner[:, 0] < channel.length)
    runs = np.diff(np.flatnonzero(np.diff(np.concatenate([[0], on_floor, [0]]))).reshape(-1, 2), axis=1).ravel()
    return on_floor if (runs == 2).all() else np.zeros(len(inner), bool)


def _place(point: np.ndarray) -> str:
    return f"({point[0]:.6g}, {point[1]:.6g}) mm"


@dataclass(frozen=True)
class Outline:
    """The undeformed interface.

    Points on the floor between the first and the last one, two at a time, are the end of one body and the start of the
    next: several bodies stand on the floor, and the interface follows the floor between them.

    Args:
        points: Points (x, y) from left to right, mm; the first and last lie on the floor or on the channel's ends.
        spline: whether `points` are control points of a cubic spline (parametrised by chord length) or the outline.
        nodes: number of interface nodes, equally spaced by arclength; None keeps `points` as they are.

    Raises:
        InvalidInput: too few points or nodes, points that are not pairs of numbers, or nodes None with a spline.
    """

    points: tuple[tuple[float, float], ...] = CONTROL_POINTS
    spline: bool = True
    nodes: int | None = NODES

    def __post_init__(self) -> None:
        shape = np.shape(np.array(self.points, dtype=object))
        if len(shape) != 2 or shape[1] != 2 or shape[0] < 3:
            raise unfit("points of the outline", self.points, "at least three pairs (x, y) in mm")
        for body in bodies(np.array(self.points, float)):
            if body.stop - body.start < 3:
                x, y = self.points[body.start]
                found = f"{body.stop - body.start} point(s) from ({x:g}, {y:g}) mm on"
                wanted = "at least three points, with two neighbouring points on the floor between bodies"
                raise unfit("body of the outline", found, wanted)
        if self.nodes is None and self.spline:
            raise unfit("nodes of the outline", None, "a number of nodes for a spline", "Give nodes, e.g. 66.")
        if self.nodes is not None and self.nodes < LEAST:
            raise unfit("nodes of the outline", self.nodes, f"at least {LEAST}")

    def interface(self) -> Interface:
        """Return the undeformed interface, mm."""
        points = np.array(self.points, float)
        parts = [points[body] for body in bodies(points)]
        curves = [self._curve(part) for part in parts]
        if self.nodes is None:
            return Interface.polyline(np.concatenate([curve.points for curve in curves]))
        lengths = np.array([curve.lengths.sum() for curve in curves])
        counts = np.maximum(LEAST, np.rint(self.nodes * lengths / lengths.sum()).astype(int))
        pieces = [curve.resampled(int(count)).points for curve, count in zip(curves, counts, strict=True)]
        for piece, part in zip(pieces, parts, strict=True):
            piece[[0, -1]] = part[[0, -1]]
        return Interface.polyline(np.concatenate(pieces))

    def _curve(self, points: Float[np.ndarray, "point 2"]) -> Interface:
        if not self.spline or len(points) < 3:
            return Interface.polyline(points)
        chords = np.linalg.norm(np.diff(points, axis=0), axis=1)
        spline = CubicSpline(np.concatenate([[0.0], np.cumsum(chords)]), points, axis=0)
        return Interface.polyline(spline(np.linspace(0.0, spline.x[-1], 4001)))


def bodies(points: Float[np.ndarray, "point 2"]) -> list[slice]:
    """Return which points belong to each body: a pair of points on the floor separates two of them."""
    on_floor = np.abs(points[:, 1]) < ON_WALL
    starts = np.flatnonzero(on_floor[1:-2] & on_floor[2:-1]) + 2
    edges = [0, *starts.tolist(), len(points)]
    return [slice(a, b) for a, b in pairwise(edges)]


def finite(given: Any) -> np.ndarray:
    """Return what a study file gives as an array of finite numbers; an empty one if it is none."""
    try:
        array = np.array(given, float)
    except (TypeError, ValueError, OverflowError):
        return np.empty(0)
    return array if np.isfinite(array).all() else np.empty(0)


def pairs_in(given: Any, least: int) -> Pairs | None:
    """Return a table of a study file as pairs of finite numbers; None if it is not at least so many of these."""
    pairs = finite(given)
    if pairs.ndim != 2 or pairs.shape[1] != 2 or len(pairs) < least:
        return None
    return tuple((float(a), float(b)) for a, b in pairs)


def check_clamped(clamped: Pairs, outline: Interface) -> None:
    """Refuse stretches of the floor that do not hold each body."""
    if clamped and not (np.diff(np.ravel(clamped)) > 0).all():
        expected = "stretches [from, to] of the floor in mm, from left to right, e.g. [[0.5, 0.9]]"
        raise unfit(CLAMPED, clamped, expected)
    for body in bodies(outline.points) if clamped else ():
        left, right = outline.points[body][[0, -1], 0].tolist()
        if not any(min(b, right) - max(a, left) > 0 for a, b in clamped):
            shown = ", ".join(f"{a:g} to {b:g}" for a, b in clamped)
            held = f"a stretch that holds the body that stands from {left:.4g} to {right:.4g} mm"
            raise unfit(CLAMPED, f"{shown} mm", held)
