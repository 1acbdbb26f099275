"""
A stretch that is stiffer than the rest
=======================================

Where is a strip stiff? It bends by w″ = M/B, and the logarithm of its stiffness B is a field of 15 unknowns. From 25
runs, B over the stretch is 1.62 ± 0.24; the truth is 1.81, the prior 1.13 ± 0.54. Towards the free end no moment bends
the strip, and the prior is what is left.
"""

import numpy as np

import strandline as sl
from strandline.design.active import Active
from strandline.parameters import Support
from strandline.report.plots import plot_random_field

s = (np.arange(40) + 0.5) / 40  # along the strip, from the clamp
bend = np.maximum(s[:, None] - s, 0) * 1.5 * (1 - s) ** 2 / 40  # w = bend @ (1 / B), since M = 1.5 (1 - s)²


def strip(inputs, workdir):
    """Bent strip with its derivatives by B at each of 40 places."""
    B = inputs["B"]
    slopes = np.zeros((40, 2, 40))
    slopes[:, 1] = -bend / B**2
    return sl.Simulation.of(sl.Interface.polyline(np.stack([s, bend @ (1 / B)], axis=1)), {}, {"B": slopes})


strip.sensitivities = True
truth = 1 + np.exp(-(((s - 0.4) / 0.12) ** 2))
random = np.random.default_rng(1)
seen = strip({"B": truth}, None).interface.points + [0, 0.002] * random.standard_normal((40, 2))
field = sl.GaussianField(mean=1.0, sd=0.5, length=0.15, modes=15).on("B", Support.interval(0, 1, 40))
problem = sl.Problem(
    sl.WithFields(strip, (field,)),
    sl.ParameterSpace(field.parameters),
    {},
    (sl.Observation(sl.Interface.polyline(seen), sl.PointErrors(0.002)),),
    {"normal_offset": sl.NormalOffset()},
)
result = sl.calibrate(problem, sl.Settings(runs=3, surrogate="field", active=Active(60, batch=4)))
found = result.posterior.fields["B"]
stretch = found.mean_over(near := abs(s - 0.4) < 0.1)
print(f"B over the stretch: {stretch.mean:.2f} ± {stretch.sd:.2f} after {len(result.all_runs)} runs")
print(f"prior {stretch.prior_mean:.2f} ± {stretch.prior_sd:.2f}, truth {truth[near].mean():.2f}")
plot_random_field(found, truth=truth)
