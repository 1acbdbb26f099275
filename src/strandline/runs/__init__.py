"""Forward runs: records, the ledger that keeps them, executors, campaigns."""

from strandline.runs.campaign import Progress, run_campaign
from strandline.runs.executors import Executor, InProcess, LocalProcesses
from strandline.runs.failures import FailurePolicy, Retry
from strandline.runs.ledger import Counts, Ledger
from strandline.runs.record import RunRecord, RunRequest, attempt, run_key

__all__ = [
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
    "run_campaign",
    "run_key",
]
