"""The channel around the biofilm, and which outlines fit into it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from strandline.errors import InvalidInput
from strandline.interface import Interface

__all__ = ["ON_WALL", "Channel", "check_inside", "check_outline"]

SIDES = ("left", "right")
OUTLETS = ("horizontal", "traction_free")
TOPS = ("no_slip", "slip", "symmetry")
ON_WALL = 1e-9


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
                _refuse(f"{name} of the channel", value, "a length in mm above 0", "Correct it.")
        for name, choices in (("inlet", SIDES), ("outlet", OUTLETS), ("top", TOPS)):
            if getattr(self, name) not in choices:
                _refuse(f"{name} of the channel", getattr(self, name), f"one of {', '.join(choices)}", "Choose one.")


def check_outline(outline: Interface, channel: Channel) -> None:
    """Refuse an outline that does not bound a solid on the channel's floor.

    It starts on the floor or on the left end of the channel, ends on the floor or on the right end (both on the floor:
    a bump; neither: a layer), runs from left to right, stays inside the channel elsewhere and does not cross itself.
    Two neighbours on the floor between the ends separate two bodies.

    Raises:
        InvalidInput: The outline is not allowed; the message shows the place, mm.
    """
    outline.require_simple()
    first, last = outline.points[0], outline.points[-1]
    if first[0] > last[0]:
        _refuse("direction of the outline", _place(first), "points from left to right", "Reverse their order.")
    for point, wall in ((first, 0.0), (last, channel.length)):
        on_floor = abs(point[1]) < ON_WALL and 0 < point[0] < channel.length
        on_end = abs(point[0] - wall) < ON_WALL and 0 < point[1] < channel.height
        if not (on_floor or on_end):
            _refuse(
                "end of the outline", _place(point), f"a point on the floor y = 0 or on the channel's end x = {wall:g}",
                "Move or add the end point.",
            )  # fmt: skip
    check_inside(outline.points, channel)


def check_inside(points: Sequence[tuple[float, float]] | Float[np.ndarray, "point 2"], channel: Channel) -> None:
    """Refuse an outline, or control points of one, that leaves the channel between its ends.

    Raises:
        InvalidInput: The outline is not allowed; the message shows the place, mm.
    """
    inner = np.asarray(points, float)[1:-1]
    inner = inner[~_between_bodies(inner, channel)]
    inside = (inner[:, 0] > 0) & (inner[:, 0] < channel.length) & (inner[:, 1] > 0) & (inner[:, 1] < channel.height)
    if not inside.all():
        _refuse(
            "outline outside the channel",
            _place(inner[np.argmin(inside)]),
            f"points inside [0, {channel.length:g}] × [0, {channel.height:g}] mm",
            "Correct the point or the channel. A spline may overshoot: add points, or `spline: false`. Two bodies need"
            " two neighbouring points on the floor between them.",
        )


def _between_bodies(inner: Float[np.ndarray, "point 2"], channel: Channel) -> Bool[np.ndarray, " point"]:
    """Return which points are the end of one body and the start of the next: two neighbours on the floor."""
    on_floor = (np.abs(inner[:, 1]) < ON_WALL) & (inner[:, 0] > 0) & (inner[:, 0] < channel.length)
    runs = np.diff(np.flatnonzero(np.diff(np.concatenate([[0], on_floor, [0]]))).reshape(-1, 2), axis=1).ravel()
    return on_floor if (runs == 2).all() else np.zeros(len(inner), bool)


def _place(point: np.ndarray) -> str:
    return f"({point[0]:.6g}, {point[1]:.6g}) mm"


def _refuse(what: str, value: object, expected: str, remedy: str) -> None:
    raise InvalidInput(what, value=value, expected=expected, remedy=remedy)
