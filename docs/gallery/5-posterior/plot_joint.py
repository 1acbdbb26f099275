"""
Joint posterior
===============

Weighted particles in hexagons, with lines that enclose 10, 50 and 90 % by kernel density and Gaussian approximation.
"""

import strandline as sl
from strandline.report.plots import plot_joint

result = sl.load_result("../studies/biofilm")
plot_joint(result.posterior, ("E", "nu"), truth={"E": 400.0, "nu": 0.3})
