"""What drives the flow: a volume rate with a profile over the inlet, or a pressure drop.

A profile is a function of the height y (point,), mm, and of the heights between which the fluid enters; it returns
velocities in any unit, since they are scaled to the volume rate. A new one is one function and a line in `PROFILES`.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from strandline.errors import InvalidInput
from strandline.models.protocol import ModelInput
from strandline.registry import lookup

__all__ = ["DROP", "PARABOLA", "PRESSURE", "PROFILES", "RATE", "Profile", "as_pairs", "check_inflow", "entering"]

Heights = Float[np.ndarray, " point"]
Profile = Callable[[Any, float, float], Any]
Pairs = tuple[tuple[float, float], ...]

PARABOLA, PRESSURE = "parabola", "pressure"
RATE = ModelInput("V_in", "mm^2/s", 0.0, np.inf, high_included=False, meaning="inflow volume rate per depth")
DROP = ModelInput("p_drop", "Pa", 0.0, np.inf, high_included=False, meaning="pressure drop from inlet to outlet")
SAMPLES = 1001
"""Heights at which a profile is evaluated; between them it is linear."""
PLACE = "inflow of the biofilm model"
COVERED = 1e-9


def parabola(y: Heights, bottom: float, top: float) -> Heights:
    """Return the developed profile between two walls."""
    return (y - bottom) * (top - y)


def plug(y: Heights, bottom: float, top: float) -> Heights:
    """Return the same velocity everywhere."""
    return np.ones_like(y)


PROFILES: dict[str, Profile] = {PARABOLA: parabola, "plug": plug}
"""Names in study files → profiles."""


def check_inflow(inflow: str | Pairs, bottom: float, top: float) -> None:
    """Refuse an inflow that does not enter between two heights, mm.

    Raises:
        InvalidInput: There is no such profile, it does not cover the inlet, or it does not enter.
    """
    if inflow != PRESSURE:
        entering(inflow, bottom, top)


def entering(inflow: str | Pairs, bottom: float, top: float) -> tuple[Heights, Heights]:
    """Return heights, mm, and velocities of a profile, linear between them, whose volume rate is above 0.

    Args:
        inflow: Name of a profile, ``module:name``, or pairs (y, v).
        bottom: Height where the inlet begins, mm.
        top: Height where it ends, mm.

    Raises:
        InvalidInput: See `check_inflow`.
    """
    y, v = _of_profile(inflow, bottom, top) if isinstance(inflow, str) else _of_table(inflow, bottom, top)
    if not np.isfinite(v).all():
        raise _refused("a velocity that is not finite", "finite velocities")
    if (v < 0).any():
        where = int(np.argmin(v))
        raise _refused(f"{v[where]:g} at y = {y[where]:g} mm", "velocities that enter the channel, 0 or above")
    if not np.trapezoid(v, y) > 0:
        raise _refused(f"no net inflow for y from {bottom:g} to {top:g} mm", "a volume rate above 0")
    return y, v


def _of_profile(name: str, bottom: float, top: float) -> tuple[Heights, Heights]:
    profile = lookup({**PROFILES, PRESSURE: None}, name, PLACE)
    y = np.linspace(bottom, top, SAMPLES)
    try:
        v = np.asarray(profile(y, bottom, top), float)
    except Exception as error:
        raise _refused(f"{name}, {type(error).__name__}: {error}", "a function of y, bottom and top, in mm") from None
    if v.shape != y.shape:
        raise _refused(f"{name}, an array of shape {v.shape}", f"one velocity for each height, shape {y.shape}")
    return y, v


def _of_table(table: Pairs, bottom: float, top: float) -> tuple[Heights, Heights]:
    y, v = np.array(as_pairs(table)).T
    if not (np.diff(y) > 0).all():
        where = int(np.argmax(np.diff(y) <= 0))
        raise _refused(f"y = {y[where + 1]:g} mm after {y[where]:g} mm", "heights that increase along the table")
    if y[0] > bottom + COVERED or y[-1] < top - COVERED:
        raise _refused(
            f"a table for y from {y[0]:g} to {y[-1]:g} mm", f"one that covers the inlet, from {bottom:g} to {top:g} mm"
        )
    inside = y[(y > bottom + COVERED) & (y < top - COVERED)]
    heights = np.concatenate([[bottom], inside, [top]])
    return heights, np.interp(heights, y, v)


def as_pairs(table: Any) -> Pairs:
    """Return a table from a study file as pairs (y, v).

    Raises:
        InvalidInput: It is no list of at least two pairs of finite numbers.
    """
    try:
        pairs = np.array(table, float)
    except (TypeError, ValueError):
        pairs = np.empty(0)
    if pairs.ndim != 2 or pairs.shape[1] != 2 or len(pairs) < 2 or not np.isfinite(pairs).all():
        raise _refused(table, "a table of at least two pairs [y, v], y in mm")
    return tuple((float(y), float(v)) for y, v in pairs)


def _refused(value: object, expected: str) -> InvalidInput:
    return InvalidInput(PLACE, value=value, expected=expected, remedy="Correct the inflow.")
