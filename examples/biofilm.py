"""The main job from Python, small: the stiffness of a biofilm from the shape that a flow bends it into.

Coarse mesh and 200 forward runs; at full size it is `strandline run studies/biofilm-uniform`. Takes about a minute:
python examples/biofilm.py. Writes ledger.sqlite and figures/posterior.png into the current folder; started again
there, it makes no forward run twice.
"""

from pathlib import Path

import strandline as sl
from strandline.report.plots import plot_joint

model = sl.Biofilm(mesh="coarse")
truth = {"E": 400.0, "nu": 0.3, "V_in": 100.0}  # Pa, 1, mm²/s
observed = sl.Observation(model(truth).interface, 0.0005)  # yours: sl.Interface.polyline(points), mm; variance, mm²
inputs = sl.ParameterSpace((sl.Parameter("E", sl.Uniform(100, 800), "Pa"), sl.Parameter("nu", sl.Uniform(-0.8, 0.5))))
problem = sl.Problem(model, inputs, {"V_in": 100.0}, (observed,), {"currents": sl.Currents(0.005)})

if __name__ == "__main__":
    result = sl.calibrate(problem, sl.Settings(runs=200), ledger="ledger.sqlite", executor=sl.LocalProcesses())
    for name, mean, sd in zip(inputs.names, result.posterior.mean, result.posterior.sd, strict=True):
        print(f"{name} = {mean:.4g} ± {sd:.2g}, truth {truth[name]:g}")

    failed = sum(not record.ok for record in result.records)
    error = result.surrogate.validation.loo_rms_near_mode
    print(f"{failed} of {len(result.records)} forward runs failed; surrogate's error near the mode {error:.2g}")
    Path("figures").mkdir(exist_ok=True)
    figure = plot_joint(result.posterior, ("E", "nu"), laplace=result.laplace, truth=truth)
    figure.savefig("figures/posterior.png", dpi=160)
