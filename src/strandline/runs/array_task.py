"""What one job of a SLURM array does: make one run of a batch in a fresh folder, and write its record to the batch.

`strandline.studies.array_task` is the command for the model of a study.
"""

import signal
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from strandline.foundations import InvalidInput
from strandline.models import ForwardModel, asks_sensitivities, fingerprint, with_sensitivities
from strandline.runs.executors.slurm_array import UNUSABLE
from strandline.runs.executors.slurm_batch import ArrayBatch
from strandline.runs.ledger.record import RunRecord, RunRequest, ended, with_log
from strandline.runs.worker import packed_model
from strandline.runs.worker_slot import WorkerSlot


def run_task(folder: Path, index: int, load: Callable[[], ForwardModel]) -> None:
    """Make one run of the batch in `folder`, of the model that `load` returns, and write its record; do nothing if it
    has one.

    The run is made in its own process: a crash, a hang and the end of the walltime, which SLURM announces with SIGUSR1,
    become records.
    """
    walltime_over = threading.Event()
    signal.signal(signal.SIGUSR1, lambda number, frame: walltime_over.set())
    try:
        batch = ArrayBatch.read(folder)
    except FileNotFoundError:
        return  # the batch was given up meanwhile
    if index in batch.present()[0] or index in batch.present()[1]:
        return
    request, began = batch.requests[index], time.monotonic()
    try:
        slot = WorkerSlot(packed_model(_fitting(load(), batch)))
        try:
            record = slot.run(request, batch.timeout, wanted=lambda: not walltime_over.is_set())
        finally:
            slot.close()
    except InvalidInput as error:
        batch.put(index, ended(request, "killed", UNUSABLE, str(error)))
        return
    if record is None or walltime_over.is_set():
        record = _out_of_walltime(record, request, time.monotonic() - began)
    batch.put(index, record)


def _fitting(model: ForwardModel, batch: ArrayBatch) -> ForwardModel:
    """Return the model as the batch needs it; refuse one that has changed since."""
    if batch.sensitivities and not asks_sensitivities(model):
        model = with_sensitivities(model)
    if fingerprint(model) != batch.fingerprint:
        raise InvalidInput(
            "the model has changed since the runs were submitted",
            value=fingerprint(model),
            expected=batch.fingerprint,
            remedy="Cancel the array, or undo the change.",
        )
    return model


def _out_of_walltime(record: RunRecord | None, request: RunRequest, seconds: float) -> RunRecord:
    """Return the record of a run that was stopped shortly before SLURM would have stopped it."""
    if record is not None and record.state != "timeout":
        return record
    killed = ended(request, "timeout", "walltime", "still running at the end of its job's walltime, and killed")
    return with_log(replace(killed, seconds=seconds), "" if record is None else record.log)
