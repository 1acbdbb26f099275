"""A strip whose stiffness is a random field, and the posterior of its modes."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from strandline.calibration import Problem, Settings, calibrate
from strandline.discrepancy import TrackedPoints
from strandline.interface import Interface, Observation
from strandline.models import ModelInput
from strandline.models.fields import WithFields
from strandline.parameters import GaussianField, Parameter, ParameterSpace, Support, Uniform
from strandline.smc import SMCSettings
from strandline.studies import load_study
from strandline.studies.write.summary import summarise
from strandline.testing.studies import write_study

S = np.linspace(0.0, 1.0, 41)
FIELD = GaussianField(2.0, 0.5, 0.3, modes=10).on("B", Support(S[:, None], np.full(41, 1 / 41)), "N mm^2")
TRUTH = dict(zip(FIELD.names, (0.8, -0.5, 0.4, *[0.2] * 7), strict=True))


def strip(inputs, workdir):
    """Return the strip that its own load bends, w'' = q (1 - s)²/(2 B), where an input tilts it."""
    slope = np.cumsum(1.5 * (1 - S) ** 2 / inputs["B"]) / 40
    return Interface.polyline(np.stack([S, np.cumsum(slope) / 40 + inputs["tilt"] * S + inputs["lift"] * S**2], axis=1))


strip.inputs = tuple(ModelInput(name, "1", -np.inf, np.inf) for name in ("B", "tilt", "lift"))


def strip_study(folder, *scalars):
    """Return a draft of a study of the field and scalars, its calibration and its summary."""
    model, unknown = WithFields(strip, (FIELD,)), {one.name for one in scalars}
    at = {**TRUTH, "tilt": 0.05, "lift": 0.02}
    fixed = {name: at[name] for name in ("tilt", "lift") if name not in unknown}
    space = ParameterSpace((*scalars, *FIELD.parameters))
    seen = Observation(model(at, Path()), 0.01**2)
    smc = SMCSettings(rejuvenation_steps=4, zeta=0.5)
    settings = Settings(runs=64, particles=1000, smc=smc, surrogate="field", draft=True)
    study = load_study(write_study(folder, draft=True))
    problem = Problem(model, space, fixed, (seen,), {"tracked_points": TrackedPoints()})
    changed = {"model": model, "space": space, "fixed": fixed, "observed": {"": seen.interface}, "truth": at}
    study = replace(study, settings=settings, **changed)
    calibration = calibrate(problem, settings, ledger=study.ledger_path)
    return study, calibration, summarise(study, calibration, new_runs=64, reused_runs=0)


TILT = Parameter("tilt", Uniform(-0.2, 0.2))
