"""The stopping rule: where whole calibrations stop, and how wrong their posterior is there."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from verification.validation.active.cases import NAMES, case, truth_of
from verification.validation.active.grow import initial_runs
from verification.validation.tables import STUDIES

from strandline.calibration import Problem, Settings, calibrate
from strandline.design.active import Active
from strandline.models.protocol import with_sensitivities
from strandline.runs import InProcess, Ledger
from strandline.smc import SMCSettings
from strandline.studies import load_study

ECONOMY = SMCSettings(rejuvenation_steps=15, zeta=0.5)


def stopped(name: str, quadrature: str, *, sensitivities: bool, seed: int, most: int = 200) -> dict[str, Any]:
    """Calibrate S3 or S5 (joint reading) with an active design, and compare with quadrature of the true model.

    `chosen` are the runs without those of a check at the end; errors are the largest ones, of a mean in standard
    deviations, of a standard deviation as a share; `seconds` are those of choosing, sampling and the like, by stage.
    """
    one = case(name, quadrature)
    truth = truth_of(one).posterior
    study = load_study(STUDIES / NAMES[name])
    model: Any = with_sensitivities(study.model) if sensitivities else study.model
    dim = one.space.dim
    active = Active(runs=most, initial=initial_runs(dim, sensitivities=sensitivities), batch=2 if dim < 3 else 4)
    settings = Settings(
        runs=active.initial or 0,
        scramble=seed,
        surrogate="field",
        active=active,
        particles=4000,
        smc=ECONOMY,
        seed=seed,
        nuisance_values=2,
    )
    problem = Problem(model, one.space, study.fixed, one.observations, {"currents": one.measure})
    with tempfile.TemporaryDirectory() as home, Ledger.open(Path(home) / "l.sqlite", model=model) as ledger:
        found = calibrate(problem, settings, ledger=ledger, executor=InProcess())
    certificate = found.field.certificate
    axes = [one.space.names.index(name) for name in ("E", "nu")]
    check = None if certificate.checked is None else certificate.checked.check
    weights = None if check is None else check.reweighting
    last_check = len(certificate.batches[-1].points) if certificate.batches[-1].kind == "check" else 0
    return {
        "study": name,
        "quadrature": quadrature,
        "sensitivities": sensitivities,
        "seed": seed,
        "runs": len(found.records),
        "chosen": len(found.records) - last_check,
        "converged": certificate.converged,
        "checks": sum(step.check is not None for step in certificate.steps),
        "k_hat": None if weights is None else float(weights.smoothed.k_hat),
        "mean_error": float(np.abs((found.posterior.mean[axes] - truth.mean) / truth.sd).max()),
        "sd_error": float(np.abs(found.posterior.sd[axes] / truth.sd - 1).max()),
        "seconds": dict(found.seconds),
    }
