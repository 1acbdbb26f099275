"""
Where the first runs lie
========================

A Sobol sequence fills the box of the inputs more evenly than random numbers.
"""

import numpy as np
from matplotlib.figure import Figure

import strandline as sl

figure = Figure(figsize=(6.5, 3.2), layout="constrained")
panels = figure.subplots(1, 2, sharey=True)
points = {"Sobol": sl.sobol(128, 2), "random": np.random.default_rng(1).random((128, 2))}
for ax, (name, values) in zip(panels, points.items(), strict=True):
    ax.plot(*values.T, ".", color="tab:blue")
    ax.set(title=name, aspect="equal", xlim=(0, 1), ylim=(0, 1))
figure
