"""
Runs chosen where they matter
=============================

An active design puts its runs where the posterior lies; the shade tells when each was made.
"""

from matplotlib.figure import Figure

import strandline as sl

result = sl.load_result("../studies/biofilm")
with sl.Ledger.open(result.study.ledger_path, model=None, read_only=True) as ledger:
    inputs = [record.inputs for record in ledger if record.ok and record.inputs["V_in"] == 100.0]
figure = Figure(figsize=(5, 3.6), layout="constrained")
ax = figure.subplots()
result.plot.joint(ax=ax, colour_bar=False)
E, nu = [one["E"] for one in inputs], [one["nu"] for one in inputs]
dots = ax.scatter(E, nu, c=range(len(E)), cmap="viridis", edgecolors="white", zorder=5)
ax.set(xlim=(100, 800), ylim=(-0.8, 0.5))
figure.colorbar(dots, label="number of the run")
figure
