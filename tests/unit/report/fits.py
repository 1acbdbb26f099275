"""Misfits as they are found: conditions with residuals, and what is said of them."""

import numpy as np

from strandline.calibration import Misfit
from strandline.calibration.misfit import ConditionMisfit, FitVerdict, Region, verdict_on
from strandline.interface import PointErrors
from strandline.likelihood.noise_rule import ResidualNoise, StatedErrors

ARC = np.linspace(0.0, 1.2, 31)
BAD = Region(0.9, 1.1, 0.006, 0.0065, "above", 5.2, 0.0004)
FINE = Region(0.0, 0.9, 0.0001, 0.001, "below", 0.4, 1.0)


def condition(*regions: Region, name: str = "V50", length: float = 0.02, line: bool = True) -> ConditionMisfit:
    stated, residual = StatedErrors(PointErrors(0.001), assumed=False), 0.002 * np.sin(9 * ARC)
    noise = ResidualNoise(0.001, 0.02), ResidualNoise(0.0014, length)
    return ConditionMisfit(name, ARC, residual, stated, *noise, 0.3, 0.4, regions, surface=not line)


def verdict(*conditions: ConditionMisfit, p=0.43, d=0.5, waves=0.5, run_alone=False) -> FitVerdict:
    return verdict_on(p, d, waves, conditions, run_alone=run_alone)


def misfit(*conditions: ConditionMisfit, p=0.43) -> Misfit:
    said = verdict(*conditions, p=p)
    return Misfit(said.text, said.flagged, p, 0.5, 0.2, conditions, ("The interface was predicted by a spell.",))
