"""Where the foot of the solid is held on the floor."""

from typing import Any

import numpy as np

from strandline.errors import InvalidInput
from strandline.interface import Interface
from strandline.models.biofilm.outline import bodies

__all__ = ["as_stretches", "check_clamped"]

Stretches = tuple[tuple[float, float], ...]


def as_stretches(given: Any) -> Stretches:
    """Return stretches of the floor from a study file as pairs (from, to), mm.

    Raises:
        InvalidInput: They are no list of pairs of numbers, in increasing order without overlap.
    """
    try:
        pairs = np.array(given, float)
    except (TypeError, ValueError):
        pairs = np.empty(0)
    shaped = pairs.ndim == 2 and pairs.shape[1] == 2 and np.isfinite(pairs).all()
    if not (shaped and (np.diff(pairs.ravel()) > 0).all()):
        raise _refused(given, "stretches [from, to] of the floor in mm, from left to right, e.g. [[0.5, 0.9]]")
    return tuple((float(a), float(b)) for a, b in pairs)


def check_clamped(clamped: Stretches, outline: Interface) -> None:
    """Refuse stretches that do not hold each body.

    Raises:
        InvalidInput: Some body would not be held; the message shows where it stands.
    """
    if not clamped:
        return
    as_stretches(clamped)
    for body in bodies(outline.points):
        left, right = outline.points[body][[0, -1], 0].tolist()
        if not any(min(b, right) - max(a, left) > 0 for a, b in clamped):
            shown = ", ".join(f"{a:g} to {b:g}" for a, b in clamped)
            raise _refused(
                f"{shown} mm", f"a stretch that holds the body that stands from {left:.4g} to {right:.4g} mm"
            )


def _refused(value: object, expected: str) -> InvalidInput:
    return InvalidInput("clamped of the biofilm model", value=value, expected=expected, remedy="Correct the stretches.")
