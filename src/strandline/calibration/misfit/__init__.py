"""Whether the model explains the observations within the noise, whatever the posterior."""

from strandline.calibration.misfit.assess_fit import misfit_of
from strandline.calibration.misfit.best_fit import Prediction, by_field, by_runs
from strandline.calibration.misfit.verdict import DRAFT, ConditionMisfit, Effort, Misfit, Region, unlikely_errors
