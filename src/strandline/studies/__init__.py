"""Study folders: the YAML schema, loading, running, results."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from strandline.studies.check import PosteriorCheck, check_posterior
    from strandline.studies.load import load_study
    from strandline.studies.result import Result, load_result
    from strandline.studies.run import Outcome, run_study
    from strandline.studies.study import Study

__all__ = ["Outcome", "PosteriorCheck", "Result", "Study", "check_posterior", "load_result", "load_study", "run_study"]

_MODULES = {
    "PosteriorCheck": "check",
    "Outcome": "run",
    "Result": "result",
    "Study": "study",
    "check_posterior": "check",
    "load_result": "result",
    "load_study": "load",
    "run_study": "run",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used: writing a study folder needs no numerics."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
