"""
Where runs fail
===============

Failed runs are kept, with their kind and their log. Here the biofilm is so soft that no steady state exists.
"""

from matplotlib.figure import Figure

import strandline as sl

study = sl.load_study("../studies/biofilm")
with sl.Ledger.open(study.ledger_path, model=None, read_only=True) as ledger:
    records = list(ledger)
figure = Figure(figsize=(4.5, 3.4), layout="constrained")
ax = figure.subplots()
for state, marker in (("ok", "o"), ("failed", "x")):
    some = [record.inputs for record in records if record.state == state]
    ax.plot([one["E"] for one in some], [one["nu"] for one in some], marker, label=f"{len(some)} {state}")
ax.set(xlabel="E [Pa]", ylabel="ν")
ax.legend()
figure
