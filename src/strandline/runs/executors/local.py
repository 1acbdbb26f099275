"""Runs on this machine: in this process, or in worker processes."""

import contextlib
import os
import shutil
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from operator import length_hint
from queue import Empty, SimpleQueue
from threading import Event, Thread
from typing import ClassVar

from strandline.models.protocol import ForwardModel
from strandline.runs.executors.shared import Dispatcher, require_count, require_timeout
from strandline.runs.record import RunRecord, RunRequest, attempt
from strandline.runs.scratch import scratch_folder
from strandline.runs.worker import packed_model, require_posix
from strandline.runs.worker_slot import WorkerSlot

LONGEST_WAIT_SECONDS = 0.5
"""Time after which requests are pulled again if there were none the last time."""


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


@dataclass(frozen=True)
class LocalProcesses:
    """Runs in worker processes on this machine; a crash or a hang costs only the run that it hits.

    Args:
        workers: Worker processes; default: one per available core. Each computes on one thread.
        timeout: Seconds after which a run is killed; default: never.

    Workers are fresh interpreters that load the model once. Each run has its own empty folder, which is removed
    afterwards. The simulator's output is kept if the run did not end well. Workers stay alive while there is no run for
    them yet (`NOT_NOW`).
    """

    workers: int | None = None
    timeout: float | None = None

    asks_again: ClassVar[bool] = True

    def __post_init__(self) -> None:
        require_count("workers", self.workers, remedy="Leave it out to use all cores.")
        require_timeout(self.timeout)

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
        crew = _Crew(setup, iter(requests), self.timeout, number)
        try:
            yield from crew.records()
        finally:
            crew.close()


class _Crew(Dispatcher["_SlotThread"]):
    """The worker slots of one call, each with a thread that waits for its runs."""

    def __init__(self, setup: bytes, requests: Iterator[RunRequest], timeout: float | None, number: int) -> None:
        super().__init__(requests)
        self.news: SimpleQueue[tuple[_SlotThread, object]] = SimpleQueue()
        self.stopped = Event()
        self.idle: list[_SlotThread] = []
        self.out = 0
        self.places = [_SlotThread(setup, timeout, self.news, self.stopped) for _ in range(number)]
        for place in self.places:
            place.start()

    def free(self) -> "_SlotThread | None":
        taken = [place for place, _ in self.done]
        return next((place for place in self.idle if place not in taken), None)

    def submit(self, request: RunRequest, place: "_SlotThread") -> None:
        self.idle.remove(place)
        self.out += 1
        place.inbox.put(request)

    def hear(self, *, wait: bool) -> None:
        with contextlib.suppress(Empty):
            self._take(*(self.news.get(timeout=LONGEST_WAIT_SECONDS) if wait else self.news.get_nowait()))
            while True:
                self._take(*self.news.get_nowait())

    def busy(self) -> bool:
        return self.out > 0

    def close(self) -> None:
        """Stop the workers: the idle ones by hanging up, the others at once."""
        self.stopped.set()
        for place in self.places:
            place.inbox.put(None)
        for place in self.places:
            place.join()

    def _take(self, place: "_SlotThread", found: object) -> None:
        """Note that a place has loaded the model or made a run, or raise the error that keeps it from doing so."""
        if isinstance(found, BaseException):
            raise found
        self.idle.append(place)
        if isinstance(found, RunRecord):
            self.out -= 1
            self.done.append((place, found))


class _SlotThread(Thread):
    """A worker slot in its own thread, which makes the runs in `inbox`; `None` in it is the end."""

    def __init__(
        self, setup: bytes, timeout: float | None, news: "SimpleQueue[tuple[_SlotThread, object]]", stopped: Event
    ) -> None:
        super().__init__(daemon=True)
        self.setup, self.timeout, self.news, self.stopped = setup, timeout, news, stopped
        self.inbox: SimpleQueue[RunRequest | None] = SimpleQueue()

    def run(self) -> None:
        """Load the model, then make one run after the other, and report each to `news`."""
        try:
            with contextlib.closing(WorkerSlot(self.setup)) as slot:
                self.news.put((self, slot.start(wanted=self.wanted)))
                for request in iter(self.inbox.get, None):
                    self.news.put((self, slot.run(request, self.timeout, wanted=self.wanted)))
        except BaseException as error:
            self.news.put((self, error))

    def wanted(self) -> bool:
        """Return whether the runs of this call are still wanted."""
        return not self.stopped.is_set()


def usable_cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
