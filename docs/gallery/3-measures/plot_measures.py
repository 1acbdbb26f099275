"""
Three measures of the same distance
===================================

How far the run at each stiffness is from the one at 400 Pa, by three measures, each divided by its largest value.
"""

from matplotlib.figure import Figure

import strandline as sl

biofilm = sl.Biofilm(mesh="coarse")
runs = {E: biofilm({"E": E, "nu": 0.3, "V_in": 100.0}).interface for E in (280, 320, 360, 400, 450, 520, 600, 800)}
measures = {
    "measurement lines": sl.MeasurementLines(10),
    "closest point": sl.ClosestPoint(),
    "currents, 5 µm": sl.Currents(0.005),
}
figure = Figure(figsize=(5, 3.2), layout="constrained")
ax = figure.subplots()
for name, measure in measures.items():
    distances = [measure(run, runs[400]) ** 0.5 for run in runs.values()]
    ax.plot(list(runs), [d / max(distances) for d in distances], "o-", label=name)
ax.set(xlabel="E [Pa]", ylabel="distance, share of the largest")
ax.legend()
figure
