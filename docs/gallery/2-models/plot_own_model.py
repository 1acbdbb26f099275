"""
A simulator of one's own
========================

Any Python function that returns points will do: here a cantilever under a pressure.
"""

from pathlib import Path

import numpy as np

import strandline as sl
from strandline.report.plots import plot_interfaces


def beam(inputs, workdir):
    """Bent axis of a clamped beam, 1 mm long and 0.2 mm high (Euler–Bernoulli)."""
    x = np.linspace(0.0, 1.0, 21)
    w = inputs["q"] * x**2 * (6 - 4 * x + x**2) / (2 * inputs["E"] * 0.2**3)
    return sl.Interface.polyline(np.stack([x, w], axis=1))


bent = {f"E = {E} Pa": beam({"E": E, "q": 0.25}, Path()) for E in (200, 400, 800)}
plot_interfaces(simulated=bent)
