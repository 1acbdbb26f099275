"""
How far currents see
====================

The distance of two parallel lines by the norm of currents: beyond a few widths of the kernel it stays the same.
"""

import numpy as np
from matplotlib.figure import Figure

import strandline as sl

x = np.linspace(0.0, 1.0, 101)
shifts = np.linspace(0.0, 0.06, 31)
lines = [sl.Interface.polyline(np.stack([x, np.full_like(x, s)], axis=1)) for s in shifts]
figure = Figure(figsize=(5, 3.2), layout="constrained")
ax = figure.subplots()
for width in (0.0025, 0.005, 0.01, 0.02):
    norm = sl.Currents(width)
    ax.plot(1e3 * shifts, [norm(line, lines[0]) ** 0.5 for line in lines], label=f"width {1e3 * width:g} µm")
ax.set(xlabel="shift [µm]", ylabel="norm of the difference")
ax.legend()
figure
