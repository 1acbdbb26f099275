"""
What the picture cannot tell
============================

Combinations of the inputs from the least to the best known: stiffness and Poisson's ratio can make up for each other.
"""

import strandline as sl

answer = sl.next_experiment(sl.load_study("../studies/biofilm"))
answer.figures["next_directions"]
