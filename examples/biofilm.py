"""The main job from Python, small: the stiffness of a biofilm from the shape that a flow bends it into.

Coarse mesh and 200 forward runs instead of 1000; the study at full size is `strandline run studies/biofilm-uniform`.
Takes about a minute on two cores:  python examples/biofilm.py [FOLDER]
Started again in the same folder, it makes no run twice: they stand in FOLDER/ledger.sqlite.
"""

import sys
from pathlib import Path

import jax

from strandline.calibrate import Calibration, Problem, Settings, calibrate
from strandline.discrepancy import Currents
from strandline.interface import Observation
from strandline.models.biofilm.model import Biofilm
from strandline.models.protocol import fingerprint
from strandline.parameters import Parameter, ParameterSpace
from strandline.plots import plot_joint
from strandline.priors import Uniform
from strandline.runs import Ledger, LocalProcesses
from strandline.smc import SMCSettings

TRUTH = {"E": 400.0, "nu": 0.3, "V_in": 100.0}  # Pa, 1, mm²/s


def calibrated(folder: Path) -> Calibration:
    """Return the posterior of E and nu, given the interface that the model shows at `TRUTH`."""
    model = Biofilm(mesh="coarse")
    problem = Problem(
        model=model,
        space=ParameterSpace((Parameter("E", Uniform(100, 800), "Pa"), Parameter("nu", Uniform(-0.8, 0.5)))),
        fixed={"V_in": 100.0},
        observations=(Observation(model(TRUTH).interface, noise_variance=0.0005),),
        discrepancies={"currents": Currents(width=0.005)},
    )
    settings = Settings(runs=200, particles=2000, smc=SMCSettings(rejuvenation_steps=10, zeta=0.9))
    with Ledger.open(folder / "ledger.sqlite", model=fingerprint(model)) as ledger:
        return calibrate(problem, settings, ledger=ledger, executor=LocalProcesses())


def main(folder: Path) -> None:
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    result = calibrated(folder)
    posterior = result.posterior
    for name, mean, sd in zip(posterior.space.names, posterior.mean, posterior.sd, strict=True):
        print(f"{name} = {mean:.4g} ± {sd:.2g}, truth {TRUTH[name]:g}")
    failed = sum(not record.ok for record in result.records)
    print(f"{failed} of {len(result.records)} runs failed; error near the mode {result.surrogate.validation.loo_rms_near_mode:.2g}")
    figure = plot_joint(posterior, ("E", "nu"), laplace=result.laplace, truth=TRUTH)
    figure.savefig(folder / "figures" / "posterior.png", dpi=160)
    print(f"figure: {folder / 'figures' / 'posterior.png'}")


if __name__ == "__main__":  # worker processes import this file: what starts runs stands under this line
    jax.config.update("jax_enable_x64", True)
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "biofilm-example"))
