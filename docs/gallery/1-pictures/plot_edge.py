"""
The edge in a photograph
========================

A few clicks along the outline are enough: along each normal, the step from dark to bright is fitted, which locates the
edge to an eighth of a pixel here.
"""

import strandline as sl
from strandline.report.plots.picture import plot_picture

seen = sl.load_study("../studies/drop").pictures[""]
plot_picture(seen.picture, seen.path, seen.edge)
