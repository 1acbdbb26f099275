"""The stopping rule: where whole calibrations stop, and how wrong their posterior is there."""

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from verification.validation.active.cases import STUDIES, case, truth_of
from verification.validation.active.grow import initial_runs

from strandline.calibration import Problem, Settings, calibrate
from strandline.design.active import Active
from strandline.models.protocol import with_sensitivities
from strandline.runs import InProcess, Ledger
from strandline.smc import SMCSettings
from strandline.studies import load_study

__all__ = ["Stopped", "stopped"]

ECONOMY = SMCSettings(rejuvenation_steps=15, zeta=0.5)


@dataclass(frozen=True)
class Stopped:
    """Where a calibration stopped.

    Args:
        runs: Total number of runs.
        chosen: Number of runs without those of a check at the end.
        converged: Whether the certificate says so.
        checks: Number of checks made.
        mean_error: Largest error of a mean against the true posterior, in standard deviations.
        sd_error: Largest relative error of a standard deviation.
        seconds: Seconds of choosing, sampling and the like, by stage.
    """

    study: str
    quadrature: str
    sensitivities: bool
    seed: int
    runs: int
    chosen: int
    converged: bool
    checks: int
    k_hat: float | None
    mean_error: float
    sd_error: float
    seconds: dict[str, float]


def stopped(name: str, quadrature: str, *, sensitivities: bool, seed: int, most: int = 200) -> Stopped:
    """Calibrate S3 or S5 (joint reading) with an active design, and compare with quadrature of the true model."""
    one = case(name, quadrature)
    truth = truth_of(one).posterior
    study = load_study(Path("studies") / STUDIES[name])
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
    with (
        tempfile.TemporaryDirectory() as folder,
        Ledger.open(Path(folder) / "ledger.sqlite", model=model) as ledger,
    ):
        found = calibrate(problem, settings, ledger=ledger, executor=InProcess())
    assert found.field is not None
    assert found.field.certificate is not None
    certificate = found.field.certificate
    axes = [one.space.names.index(name) for name in ("E", "nu")]
    check = None if certificate.checked is None else certificate.checked.check
    weights = None if check is None else check.reweighting
    last_check = len(certificate.batches[-1].points) if certificate.batches[-1].kind == "check" else 0
    return Stopped(
        study=name,
        quadrature=quadrature,
        sensitivities=sensitivities,
        seed=seed,
        runs=len(found.records),
        chosen=len(found.records) - last_check,
        converged=certificate.converged,
        checks=sum(step.check is not None for step in certificate.steps),
        k_hat=None if weights is None else float(weights.smoothed.k_hat),
        mean_error=float(np.abs((found.posterior.mean[axes] - truth.mean) / truth.sd).max()),
        sd_error=float(np.abs(found.posterior.sd[axes] / truth.sd - 1).max()),
        seconds=dict(found.seconds),
    )
