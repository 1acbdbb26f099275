"""
Does the model fit?
===================

The residuals of one observed outline along its arc, with the noise of the camera: no wave is left.
"""

import numpy as np

import strandline as sl
from strandline.discrepancy import signed_distances
from strandline.interface import arc_lengths
from strandline.report.plots import ResidualsAlong, plot_residuals

study = sl.load_study("../studies/biofilm")
outline = np.loadtxt("../studies/biofilm/specimens/biofilm-01.csv", delimiter=",", skiprows=1)
observed = sl.Interface.polyline(outline)
posterior = sl.open_specimens(study).posterior(observed)
best = dict(zip(study.space.names, posterior.mean, strict=True)) | dict(study.fixed)
predicted = study.model(best).interface
distances = signed_distances(observed.points, predicted)
plot_residuals({"": ResidualsAlong(arc_lengths(observed), distances, sd=0.003)})
