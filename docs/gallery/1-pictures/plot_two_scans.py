"""
Two scans of one specimen
=========================

The biofilm before and under flow, in optical coherence tomography: the edges that speckle leaves visible.
"""

from matplotlib.figure import Figure

import strandline as sl

study = sl.load_study("../../../examples/oct-biofilm")
before, under = study.undeformed.picture, study.pictures[""]
figure = Figure(figsize=(7, 3.2), layout="constrained")
for ax, (title, seen) in zip(figure.subplots(1, 2), {"before": before, "under flow": under}.items(), strict=True):
    ax.imshow(seen.picture.values, cmap="gray", vmax=3 * seen.picture.values.mean())
    ax.plot(*seen.edge.points.T, color="tab:orange")
    ax.set(title=title)
    ax.set_axis_off()
figure
