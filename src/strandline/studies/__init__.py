"""Study folders: the YAML schema, loading, running, results."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from strandline.studies.check import Check, check_posterior
    from strandline.studies.run import Outcome, run_study
    from strandline.studies.study import Study, load_study

__all__ = ["Check", "Outcome", "Study", "check_posterior", "load_study", "run_study"]

_MODULES = {
    "Check": "check",
    "Outcome": "run",
    "Study": "study",
    "check_posterior": "check",
    "load_study": "study",
    "run_study": "run",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is asked for: to write a study folder takes no numerics."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
