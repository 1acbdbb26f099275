"""A pendant drop of water: the equation of Young and Laplace for an outline that turns about a vertical axis."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

import strandline as sl

DENSITY, GRAVITY = 997.0 - 1.2, 9.81  # kg/m³, water in air; m/s²
NODES = 401


def outline(inputs: Mapping[str, float], workdir: Path) -> sl.Interface:
    """Return the outline from the right over the apex, at the origin, to the left, mm.

    With the arc length s from the apex, the height z above it and the angle φ of the tangent,
    dφ/ds = 2/b - Δρ g z/γ - sin φ/x, for the surface tension γ (mN/m) and the radius b (mm) at the apex.
    """
    b, gamma = inputs["b"], inputs["gamma"]
    weight = 1e-3 * DENSITY * GRAVITY / gamma  # 1/mm²

    def slope(s: float, state: np.ndarray) -> list[float]:
        x, z, angle = state
        return [np.cos(angle), np.sin(angle), 2 / b - weight * z - (np.sin(angle) / x if s > 0 else 1 / b)]

    s = np.linspace(0.0, inputs["length"], NODES // 2 + 1)
    solved = solve_ivp(slope, (0.0, s[-1]), [0.0, 0.0, 0.0], t_eval=s, rtol=1e-9, atol=1e-12)
    if not solved.success:
        raise sl.ForwardModelError("no_outline", str(solved.message))
    half = solved.y[:2].T
    return sl.Interface.polyline(np.concatenate([half[:0:-1], half * [-1, 1]]))
