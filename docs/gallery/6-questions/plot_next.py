"""
Which experiment next?
======================

What a second picture at each flow rate can be expected to teach, and how far it narrows each input.
"""

import strandline as sl

answer = sl.next_experiment(sl.load_study("../studies/biofilm"))
answer.figures["next_candidates"]
