"""Forward runs: records, the ledger that keeps them, executors, campaigns."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from strandline.runs.batches import run_batches
    from strandline.runs.campaign import Progress, run_campaign
    from strandline.runs.executors import Executor, InProcess, LocalProcesses
    from strandline.runs.failures import FailurePolicy, Retry
    from strandline.runs.ledger import Counts, Ledger
    from strandline.runs.record import NOT_NOW, RunRecord, RunRequest, attempt, run_key

__all__ = [
    "NOT_NOW",
    "Counts",
    "Executor",
    "FailurePolicy",
    "InProcess",
    "Ledger",
    "LocalProcesses",
    "Progress",
    "Retry",
    "RunRecord",
    "RunRequest",
    "attempt",
    "run_batches",
    "run_campaign",
    "run_key",
]

_NAMES_OF = {
    "batches": "run_batches",
    "campaign": "Progress run_campaign",
    "executors": "Executor InProcess LocalProcesses",
    "failures": "FailurePolicy Retry",
    "ledger": "Counts Ledger",
    "record": "NOT_NOW RunRecord RunRequest attempt run_key",
}
_HOME = {name: module for module, names in _NAMES_OF.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    """Import a public name when it is requested, so that reading the state of a ledger loads no numerics."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
