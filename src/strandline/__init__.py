"""strandline: Bayesian calibration of computational-mechanics models from the shape of a measured interface.

The names below follow the order of the pipeline; `calibrate` runs all of it.
"""

import importlib
from typing import TYPE_CHECKING, Any

from strandline.version import __version__ as __version__

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
    from strandline.errors import ForwardModelError, InvalidInput, NumericsError, StrandlineError
    from strandline.interface import Interface, Observation, PointErrors, UnknownErrors
    from strandline.likelihood import InterfaceLikelihood
    from strandline.models.biofilm.model import Biofilm
    from strandline.models.protocol import ForwardModel, ModelInput, Simulation
    from strandline.models.python import PythonModel
    from strandline.parameters import Parameter, ParameterSpace
    from strandline.posterior import Posterior
    from strandline.posterior.quadrature import integrate
    from strandline.priors import LogNormal, LogUniform, Normal, ScaledBeta, Uniform
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

__all__ = [  # noqa: RUF022
    "Uniform",
    "Normal",
    "LogNormal",
    "LogUniform",
    "ScaledBeta",
    "Parameter",
    "ParameterSpace",
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

_NAMES_OF = {
    "priors": "Uniform LogUniform Normal LogNormal ScaledBeta",
    "parameters": "Parameter ParameterSpace",
    "interface": "Interface Observation PointErrors UnknownErrors",
    "design": "sobol",
    "models.protocol": "ForwardModel ModelInput Simulation",
    "models.biofilm.model": "Biofilm",
    "models.python": "PythonModel",
    "runs": "RunRecord Ledger InProcess LocalProcesses run_campaign",
    "discrepancy": "Discrepancy MeasurementLines TrackedPoints ClosestPoint Currents NormalOffset",
    "likelihood": "InterfaceLikelihood",
    "surrogate": "fit_log_likelihood",
    "smc": "SMCSettings sample",
    "posterior.quadrature": "integrate",
    "posterior": "Posterior",
    "calibration": "Problem Settings Observer Calibration calibrate",
    "studies": "Study load_study Outcome run_study Result load_result",
    "questions.coverage": "coverage",
    "questions.next": "next_experiment",
    "questions.what_if": "what_if",
    "questions.compare": "compare",
    "questions.specimens": "specimens watch_specimens",
    "questions.opened": "open_specimens",
    "errors": "StrandlineError InvalidInput ForwardModelError NumericsError",
}
_HOME = {name: module for module, names in _NAMES_OF.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    """Import a public name when it is requested, so that the command line's help loads no numerics."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
