"""
Interfaces that the posterior predicts
======================================

Thirty draws of the posterior, run through the model: how far each lies from the observed interface, along its arc.
"""

from matplotlib.figure import Figure

import strandline as sl
from strandline.discrepancy import signed_distances
from strandline.interface import arc_lengths

result = sl.load_result("../studies/biofilm")
biofilm = result.study.model
observed = biofilm({"E": 400.0, "nu": 0.3, "V_in": 100.0}).interface
figure = Figure(figsize=(6, 3), layout="constrained")
ax = figure.subplots()
ax.axhspan(-3, 3, color="0.9", label="noise, one standard deviation")
for E, nu in result.posterior.equally_weighted(1, 30):
    predicted = biofilm({"E": E, "nu": nu, "V_in": 100.0}).interface
    offsets = 1e3 * signed_distances(observed.points, predicted)
    ax.plot(arc_lengths(observed), offsets, color="tab:blue", alpha=0.3)
ax.set(xlabel="arc length [mm]", ylabel="offset [µm]")
ax.legend()
figure
