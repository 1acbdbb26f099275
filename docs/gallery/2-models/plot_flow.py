"""
Flow around a biofilm
=====================

The built-in model: an incompressible flow and an elastic solid, solved together on a mesh that moves with the solid.
"""

import strandline as sl
from strandline.report.plots import plot_flow

biofilm = sl.Biofilm(mesh="coarse")
plot_flow(biofilm.fields({"E": 250.0, "nu": 0.3, "V_in": 100.0}))
