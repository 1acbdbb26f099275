"""
Many specimens, one population
==============================

Twelve outlines, each with its own posterior through one surrogate; the dark intervals borrow strength from the others.
"""

import strandline as sl

answer = sl.specimens(sl.load_study("../studies/biofilm"))
answer.figures["specimens_intervals_E"]
