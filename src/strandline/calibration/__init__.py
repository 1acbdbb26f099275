"""From a problem to its posterior: `calibrate` is the whole method on one screen."""

from strandline.calibration.method import calibrate
from strandline.calibration.misfit import Misfit
from strandline.calibration.problem import Calibration, Observer, Problem, Settings

__all__ = ["Calibration", "Misfit", "Observer", "Problem", "Settings", "calibrate"]
