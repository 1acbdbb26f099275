"""
Corner plot
===========

Marginals with their priors, and the smallest regions with 68 and 95 % of the posterior.
"""

import strandline as sl

result = sl.load_result("../studies/biofilm")
result.plot.corner(truth={"E": 400.0, "nu": 0.3})
