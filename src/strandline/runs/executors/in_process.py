"""Runs in this process."""

import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from strandline.models.protocol import ForwardModel
from strandline.runs.record import RunRecord, RunRequest, attempt

__all__ = ["InProcess"]


@dataclass(frozen=True)
class InProcess:
    """Runs one after the other in this process: for small models and for debugging.

    A simulator that crashes takes the driver along, and one that hangs is waited for; `LocalProcesses` is safe.
    """

    def __call__(self, model: ForwardModel, requests: Iterable[RunRequest]) -> Iterator[RunRecord]:
        """Yield a record for each request, in their order."""
        for request in requests:
            with tempfile.TemporaryDirectory(prefix="strandline-run-", ignore_cleanup_errors=True) as folder:
                record = attempt(model, request, Path(folder))
            yield record
