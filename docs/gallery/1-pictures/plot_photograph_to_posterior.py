"""
From the photograph to the posterior
====================================

One photograph of a hanging drop, with no scale bar but the needle, and the surface tension that follows.
"""

from matplotlib.figure import Figure

import strandline as sl

result = sl.load_result("../studies/drop")
seen = result.study.pictures[""]
figure = Figure(figsize=(7, 3), layout="constrained")
photograph, marginal = figure.subplots(1, 2)
photograph.imshow(seen.picture.values, cmap="gray")
photograph.plot(*seen.edge.points.T, color="tab:orange", label="edge found")
photograph.legend(loc="lower right")
photograph.set_axis_off()
result.plot.marginal("gamma", ax=marginal, truth=72.4)
figure
