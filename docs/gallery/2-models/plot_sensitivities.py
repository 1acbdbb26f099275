"""
What each input moves
=====================

A run with sensitivities returns how each point of the interface moves with each input, from one further linear solve.
"""

from matplotlib.figure import Figure

import strandline as sl

biofilm = sl.Biofilm(mesh="coarse", sensitivities=True)
run = biofilm({"E": 400.0, "nu": 0.3, "V_in": 100.0})
x, y = run.interface.points.T
figure = Figure(figsize=(7, 3), layout="constrained")
panels = figure.subplots(1, 2, sharey=True)
for ax, (name, step) in zip(panels, {"E": 100.0, "nu": 0.1}.items(), strict=True):
    moves = step * run.sensitivities[""][name]
    ax.plot(x, y, color="0.7")
    ax.quiver(x, y, *moves.T, angles="xy", color="tab:blue", width=0.004)
    ax.set(title=f"d interface / d {name}", xlabel="x [mm]", aspect="equal", ylim=(0, 0.6))
figure
