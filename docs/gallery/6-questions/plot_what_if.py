"""
What if the assumptions were others?
====================================

The same draws under other noises, priors and measures, by weights. What moves by more than a fifth of a standard
deviation is marked.
"""

import strandline as sl

answer = sl.what_if(sl.load_study("../studies/biofilm"))
answer.figures["what_if"]
