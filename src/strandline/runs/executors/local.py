"""Runs on this machine: in this process, or in worker processes."""

import os
import shutil
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor
from concurrent.futures import wait as futures_wait
from contextlib import closing
from dataclasses import dataclass
from operator import length_hint
from threading import Event
from typing import Any, ClassVar

from strandline.models import ForwardModel
from strandline.runs.executors.shared import Dispatcher, require_count, require_seconds
from strandline.runs.ledger.record import RunRecord, RunRequest, attempt
from strandline.runs.worker import WorkerSlot, packed_model, require_posix, scratch_folder

LONGEST_WAIT_SECONDS = 0.5
"""Time after which requests are pulled again if there were none the last time."""


@dataclass(frozen=True)
class InProcess:
    """Runs one after the other in this process, for small models and debugging; a crash or a hang hits the driver."""

    def __call__(self, model: ForwardModel, requests: Iterable[RunRequest]) -> Iterator[RunRecord]:
        for request in requests:
            folder = scratch_folder()
            try:
                record = attempt(model, request, folder)
            finally:
                shutil.rmtree(folder, ignore_errors=True)
            yield record


@dataclass(frozen=True)
class LocalProcesses:
    """Runs in worker processes on this machine; a crash or a hang costs only the run that it hits.

    Args:
        workers: Worker processes; default: one per available core. Each computes on one thread.
        timeout: Seconds after which a run is killed; default: never.

    Workers are fresh interpreters that load the model once. Each run has its own empty folder, which is removed
    afterwards. The simulator's output is kept if the run did not end well. Workers wait for their next run (`NOT_NOW`).
    """

    workers: int | None = None
    timeout: float | None = None

    asks_again: ClassVar[bool] = True

    def __post_init__(self) -> None:
        require_count("workers", self.workers, remedy="Leave it out to use all cores.")
        require_seconds("timeout", self.timeout)

    def __call__(self, model: ForwardModel, requests: Iterable[RunRequest]) -> Iterator[RunRecord]:
        """Yield a record for each request as runs end.

        Raises:
            InvalidInput: the model cannot be sent to, or loaded in, a worker process.
        """
        require_posix()
        return self._run(packed_model(model), requests, self.workers or usable_cores())

    def _run(self, setup: bytes, requests: Iterable[RunRequest], limit: int) -> Iterator[RunRecord]:
        number = min(limit, length_hint(requests, limit))
        if number == 0:
            return
        with closing(_Crew(setup, iter(requests), self.timeout, number)) as crew:
            yield from crew.records()


class _Crew(Dispatcher[WorkerSlot]):
    """The worker slots of one call; a pool of threads waits for what they do."""

    def __init__(self, setup: bytes, requests: Iterator[RunRequest], timeout: float | None, number: int) -> None:
        super().__init__(requests)
        self.timeout, self.stopped, self.pool = timeout, Event(), ThreadPoolExecutor(number)
        self.slots = [WorkerSlot(setup) for _ in range(number)]
        self.idle: list[WorkerSlot] = []
        self.starting = {self.pool.submit(slot.start, wanted=self.wanted): slot for slot in self.slots}
        self.running: dict[Future[RunRecord | None], WorkerSlot] = {}

    def free(self) -> WorkerSlot | None:
        taken = [place for place, _ in self.done]
        return next((place for place in self.idle if place not in taken), None)

    def submit(self, request: RunRequest, place: WorkerSlot) -> None:
        self.idle.remove(place)
        self.running[self.pool.submit(place.run, request, self.timeout, wanted=self.wanted)] = place

    def hear(self, *, wait: bool) -> None:
        """Note which slots have loaded the model or made a run, or raise the error that keeps one from doing so."""
        under_way: list[Future[Any]] = [*self.starting, *self.running]
        if wait and not under_way:
            self.stopped.wait(LONGEST_WAIT_SECONDS)
        ended = futures_wait(under_way, LONGEST_WAIT_SECONDS if wait else 0.0, FIRST_COMPLETED).done
        for started in ended & self.starting.keys():
            started.result()
            self.idle.append(self.starting.pop(started))
        for run in [one for one in self.running if one in ended]:
            place, record = self.running.pop(run), run.result()
            self.idle.append(place)
            if record is not None:
                self.done.append((place, record))

    def busy(self) -> bool:
        return bool(self.running)

    def wanted(self) -> bool:
        return not self.stopped.is_set()

    def close(self) -> None:
        """Stop the workers: the idle ones by hanging up, the others at once."""
        self.stopped.set()
        under_way: list[Future[Any]] = [*self.starting, *self.running]
        futures_wait(under_way)
        list(self.pool.map(WorkerSlot.close, self.slots))
        self.pool.shutdown()


def usable_cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
