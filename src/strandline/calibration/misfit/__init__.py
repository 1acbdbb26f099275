"""Whether the model explains the observations within the noise, whatever the posterior."""

from strandline.calibration.misfit.effort import DRAFT, Effort
from strandline.calibration.misfit.judge import misfit_of
from strandline.calibration.misfit.prediction import Prediction, by_field, by_runs
from strandline.calibration.misfit.result import ConditionMisfit, Misfit, Region
from strandline.calibration.misfit.verdict import unlikely_errors

__all__ = [
    "DRAFT",
    "ConditionMisfit",
    "Effort",
    "Misfit",
    "Prediction",
    "Region",
    "by_field",
    "by_runs",
    "misfit_of",
    "unlikely_errors",
]
