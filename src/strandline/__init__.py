"""strandline: Bayesian calibration of computational-mechanics models from the shape of a measured interface.

The names below follow the order of the pipeline; `calibrate` runs all of it.
"""

from typing import TYPE_CHECKING

from strandline.foundations import __version__ as __version__
from strandline.foundations.doors import door

if TYPE_CHECKING:
    from strandline.calibration import Calibration, Observer, Problem, Settings, calibrate
    from strandline.design import sobol
    from strandline.discrepancy import (
        ClosestPoint,
        Currents,
        Discrepancy,
        MeasurementLines,
        NormalOffset,
        TrackedPoints,
    )
    from strandline.foundations import ForwardModelError, InvalidInput, NumericsError, StrandlineError
    from strandline.interface import Interface, Observation, PointErrors, UnknownErrors
    from strandline.likelihood import InterfaceLikelihood
    from strandline.models import ForwardModel, ModelInput, PythonModel, Simulation, WithFields
    from strandline.models.biofilm import Biofilm
    from strandline.parameters import (
        GaussianField,
        LogNormal,
        LogUniform,
        Normal,
        Parameter,
        ParameterSpace,
        ScaledBeta,
        Support,
        Uniform,
    )
    from strandline.posterior import Posterior
    from strandline.posterior.quadrature import integrate
    from strandline.questions.compare import compare
    from strandline.questions.coverage import coverage
    from strandline.questions.next import next_experiment
    from strandline.questions.opened import open_specimens
    from strandline.questions.specimens import specimens, watch_specimens
    from strandline.questions.what_if import what_if
    from strandline.runs import InProcess, Ledger, LocalProcesses, RunRecord, run_campaign
    from strandline.smc import SMCSettings, sample
    from strandline.studies import Outcome, Result, Study, load_result, load_study, run_study
    from strandline.surrogate import fit_log_likelihood
else:
    __getattr__ = door(__name__, __file__)

__all__ = [  # noqa: RUF022
    "Uniform",
    "Normal",
    "LogNormal",
    "LogUniform",
    "ScaledBeta",
    "Parameter",
    "ParameterSpace",
    "GaussianField",
    "Support",
    "Interface",
    "Observation",
    "PointErrors",
    "UnknownErrors",
    "sobol",
    "ForwardModel",
    "ModelInput",
    "Simulation",
    "Biofilm",
    "PythonModel",
    "WithFields",
    "RunRecord",
    "Ledger",
    "InProcess",
    "LocalProcesses",
    "run_campaign",
    "Discrepancy",
    "MeasurementLines",
    "TrackedPoints",
    "ClosestPoint",
    "Currents",
    "NormalOffset",
    "InterfaceLikelihood",
    "fit_log_likelihood",
    "SMCSettings",
    "sample",
    "integrate",
    "Posterior",
    "Problem",
    "Settings",
    "Observer",
    "Calibration",
    "calibrate",
    "Study",
    "load_study",
    "Outcome",
    "run_study",
    "Result",
    "load_result",
    "coverage",
    "next_experiment",
    "what_if",
    "compare",
    "specimens",
    "open_specimens",
    "watch_specimens",
    "StrandlineError",
    "InvalidInput",
    "ForwardModelError",
    "NumericsError",
]


def __dir__() -> list[str]:
    return [*globals(), *__all__]
