"""
Weighted particles
==================

What the sampler returns: particles whose area and colour show their weights.
"""

import strandline as sl

result = sl.load_result("../studies/biofilm")
result.plot.particles("E", "nu")
