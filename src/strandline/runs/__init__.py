"""Forward runs: records, the ledger that keeps them, executors, campaigns.

In: a model and inputs. Out: one `RunRecord` for each, good or failed, in the ledger at once; a campaign that is killed
goes on from there. It does not know what the runs are for.
"""

from typing import TYPE_CHECKING

from strandline.foundations.doors import door

if TYPE_CHECKING:
    from strandline.runs.batches import PlainBatch, run_batches
    from strandline.runs.campaign import Progress, run_campaign
    from strandline.runs.executors import EXECUTORS, Executor, InProcess, LocalProcesses, usable_cores, with_workers
    from strandline.runs.executors.dask import DaskCluster
    from strandline.runs.executors.slurm_array import Detached, SlurmArray, run_task
    from strandline.runs.executors.slurm_batch import known_batches
    from strandline.runs.failures import COMMON_KINDS, FailurePolicy, Retry, counted, require_kinds
    from strandline.runs.ledger.journal import note
    from strandline.runs.ledger.ledger import Counts, Ledger
    from strandline.runs.ledger.ledger_rows import outcome_digest, unsound
    from strandline.runs.ledger.ledger_schema import ATTEMPTS, EXCLUDED, INTERRUPTED, LOG_TITLE
    from strandline.runs.ledger.overview import OPEN, STATES, Attempt, Details, Driver, Overview, Run
    from strandline.runs.ledger.plans import Plan
    from strandline.runs.ledger.record import ENDS, NOT_NOW, RunRecord, RunRequest, attempt, ended, run_key, told_folder
    from strandline.runs.worker import WorkerSlot, packed_model
else:
    __getattr__ = door(__name__, __file__)

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
