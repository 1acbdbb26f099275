"""A strip of paper that overhangs a table's edge and bends under its own weight (Peirce's cantilever test)."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.integrate import cumulative_simpson, solve_bvp

import strandline as sl

NODES = 121


def overhang(inputs: Mapping[str, float], workdir: Path) -> sl.Interface:
    """Return the strip from the edge, at the origin, to its free end, mm.

    With the arc length s from the edge and the angle θ below the horizontal, B θ'' = -w (L - s) cos θ, θ'(L) = 0, for
    the bending stiffness per width B (mN mm), the weight per area w (mN/mm²) and the length L (mm). At the edge, the
    strip points down by `tilt` (degrees).
    """
    B, w, length, tilt = inputs["B"], inputs["w"], inputs["L"], np.radians(inputs["tilt"])
    s = np.linspace(0.0, length, NODES)

    def slope(s: np.ndarray, state: np.ndarray) -> np.ndarray:
        return np.stack([state[1], -w / B * (length - s) * np.cos(state[0])])

    straight = np.stack([np.full(NODES, tilt), np.zeros(NODES)])
    solved = solve_bvp(slope, lambda a, b: np.array([a[0] - tilt, b[1]]), s, straight, tol=1e-6, max_nodes=10_000)
    if not solved.success:
        raise sl.ForwardModelError("no_equilibrium", str(solved.message))
    angle = solved.sol(s)[0]
    x, y = (cumulative_simpson(part, x=s, initial=0.0) for part in (np.cos(angle), -np.sin(angle)))
    return sl.Interface.polyline(np.stack([x, y], axis=1))
