"""
Normal offsets
==============

Each observed point is compared with the nearest place of the simulated interface, along its normal.
"""

import numpy as np
from matplotlib.figure import Figure

import strandline as sl
from strandline.discrepancy import signed_distances

biofilm = sl.Biofilm(mesh="coarse")
soft, stiff = (biofilm({"E": E, "nu": 0.3, "V_in": 100.0}).interface for E in (300.0, 400.0))
offsets = 1e3 * signed_distances(soft.points, stiff)
figure = Figure(figsize=(5.5, 3), layout="constrained")
ax = figure.subplots()
ax.plot(*stiff.points.T, color="0.6", label="E = 400 Pa")
dots = ax.scatter(*soft.points.T, c=offsets, cmap="coolwarm", vmin=-np.abs(offsets).max(), vmax=np.abs(offsets).max())
ax.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
ax.legend()
figure.colorbar(dots, label="offset of E = 300 Pa [µm]")
figure
