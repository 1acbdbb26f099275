"""
Noise decides the width
=======================

The same runs, three noises: half the noise, half the width. No run is made again.
"""

from matplotlib.figure import Figure

import strandline as sl

result = sl.load_result("../studies/biofilm")
figure = Figure(figsize=(7, 2.6), layout="constrained")
for ax, sd in zip(figure.subplots(1, 3), (0.0015, 0.003, 0.006), strict=True):
    posterior = result.with_noise(sl.PointErrors(sd, length=0.02)).posterior
    sl.Result(result.study, posterior, {}).plot.joint(ax=ax, colour_bar=False)
    ax.set(title=f"{1e3 * sd:g} µm", xlim=(250, 800), ylim=(-0.6, 0.5))
figure
