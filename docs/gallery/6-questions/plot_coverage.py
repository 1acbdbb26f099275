"""
Do intervals hold what they promise?
====================================

Forty repeated experiments at truths drawn from the posterior: how often the 50 % and 90 % intervals contain them.
"""

import strandline as sl

answer = sl.coverage(sl.load_study("../studies/biofilm"), source="posterior", replicates=40)
answer.figures["coverage_intervals"]
