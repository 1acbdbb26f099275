"""Runs in this process."""

import shutil
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from strandline.models.protocol import ForwardModel
from strandline.runs.record import RunRecord, RunRequest, attempt
from strandline.runs.scratch import scratch_folder

__all__ = ["InProcess"]


@dataclass(frozen=True)
class InProcess:
    """Runs one after the other in this process: for small models and for debugging.

    A simulator that crashes takes the driver down, and one that hangs blocks it; `LocalProcesses` is safe.
    """

    def __call__(self, model: ForwardModel, requests: Iterable[RunRequest]) -> Iterator[RunRecord]:
        """Yield a record for each request, in order."""
        for request in requests:
            folder = scratch_folder()
            try:
                record = attempt(model, request, folder)
            finally:
                shutil.rmtree(folder, ignore_errors=True)
            yield record
