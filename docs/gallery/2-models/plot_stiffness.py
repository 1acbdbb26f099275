"""
Softer bends further
====================

The deformed interface for four stiffnesses, and the undeformed one.
"""

import strandline as sl
from strandline.report.plots import plot_interfaces

biofilm = sl.Biofilm(mesh="coarse")
deformed = {f"E = {E} Pa": biofilm({"E": E, "nu": 0.3, "V_in": 100.0}).interface for E in (250, 300, 400, 800)}
plot_interfaces(reference=biofilm.undeformed(), simulated=deformed)
