"""Runs in worker processes on this machine."""

import contextlib
import os
import shutil
import time
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from operator import length_hint
from pathlib import Path
from typing import ClassVar

from strandline.models.protocol import ForwardModel
from strandline.runs.executors.options import require_count, require_timeout
from strandline.runs.executors.seat import KILLED_STARTS_BORNE, LONGEST_WAIT_SECONDS, killed_while_starting
from strandline.runs.record import NOT_NOW, RunRecord, RunRequest, attempt
from strandline.runs.scratch import scratch_folder
from strandline.runs.worker import packed_model, require_posix
from strandline.runs.workers import Worker


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
        setup = packed_model(model)
        limit = usable_cores() if self.workers is None else self.workers
        return self._run(setup, requests, limit)

    def _run(self, setup: bytes, requests: Iterable[RunRequest], limit: int) -> Iterator[RunRecord]:
        number = max(1, min(limit, length_hint(requests, limit)))
        folder = scratch_folder()
        try:
            pool = _Pool(folder, setup, iter(requests), self.timeout)
            try:
                yield from pool.records(number)
            finally:
                pool.close()
        finally:
            shutil.rmtree(folder, ignore_errors=True)


class _Pool:
    """The workers of one call, the requests still to come, and the records not handed over yet."""

    def __init__(self, folder: Path, setup: bytes, requests: Iterator[RunRequest], timeout: float | None) -> None:
        self.folder, self.requests, self.timeout = folder, requests, timeout
        self.setup = folder / "model.pickle"
        self.setup.write_bytes(setup)
        self.workers: list[Worker] = []
        self.done: deque[tuple[Worker, RunRecord]] = deque()
        self.exhausted = self.told_to_wait = False
        self.launched = self.started = self.killed_starts = 0

    def records(self, number: int) -> Iterator[RunRecord]:
        """Start `number` workers and yield records until every request that was pulled is answered."""
        for _ in range(number):
            self._launch()
        while self.done or not self._finished():
            while self.done:
                yield self._handed_over()
            if self.told_to_wait:
                self._turn(0.0)  # the requests may wait for what has come meanwhile
                if self.done:
                    continue
                self._ask_again()
            if not self._finished():
                self._turn(self._patience())

    def close(self) -> None:
        """Stop the workers: the idle ones by hanging up, the others at once."""
        for worker in self.workers:
            worker.hang_up()
        deadline = time.monotonic() + 1.0
        for worker in self.workers:
            worker.end(deadline)
        self.workers.clear()

    def _handed_over(self) -> RunRecord:
        """Return the next record; before that, give the next request to the worker that made it and to no other."""
        worker, record = self.done.popleft()
        if worker in self.workers:
            self._assign(worker)
        return record

    def _finished(self) -> bool:
        return self.exhausted and not any(worker.busy for worker in self.workers)

    def _launch(self) -> None:
        self.launched += 1
        self.workers.append(Worker.launch(self.folder, self.launched, self.setup))

    def _ask_again(self) -> None:
        """Pull requests for the idle workers until `NOT_NOW` comes again."""
        idle = [worker for worker in self.workers if worker.ready and not worker.busy]
        self.told_to_wait = not idle
        for worker in idle:
            self._assign(worker)

    def _turn(self, longest: float) -> None:
        """Wait for news from the workers, up to `longest` seconds, then deal with all of it."""
        by_connection = {worker.connection: worker for worker in self.workers}
        for connection in wait(list(by_connection), timeout=longest):
            assert isinstance(connection, Connection)
            self._hear(by_connection[connection])
        for worker in list(self.workers):
            if worker.overdue() and not worker.connection.poll():
                self._lose(worker, worker.out_of_time(self.timeout or 0.0))
            elif worker.gone() and not worker.connection.poll():
                self._lose(worker, worker.vanished())

    def _patience(self) -> float:
        """Return the seconds until something must be checked even without news."""
        deadlines = [worker.deadline for worker in self.workers if worker.deadline is not None]
        return min([LONGEST_WAIT_SECONDS, *(max(0.0, deadline - time.monotonic()) for deadline in deadlines)])

    def _hear(self, worker: Worker) -> None:
        """Take what `worker` sent; a worker that has just become ready gets its first request."""
        try:
            record = worker.receive()
        except (EOFError, OSError):
            self._lose(worker, worker.vanished())
            return
        if record is None:
            self._assign(worker)
        else:
            self._keep(worker, record)

    def _lose(self, worker: Worker, record: RunRecord | None) -> None:
        """Replace a worker that is gone; keep the record of the run that it had."""
        self.workers.remove(worker)
        worker.end()
        self.killed_starts += not worker.ready
        if self.killed_starts > KILLED_STARTS_BORNE:
            raise killed_while_starting(self.killed_starts)
        if record is not None:
            self._keep(worker, record)
        if not self.exhausted:
            self._launch()

    def _keep(self, worker: Worker, record: RunRecord) -> None:
        self.done.append((worker, record))
        shutil.rmtree(worker.workdir, ignore_errors=True)

    def _assign(self, worker: Worker) -> None:
        """Pull the next request, which starts it, and send it to `worker`; try again later after `NOT_NOW`."""
        if self.exhausted or self.told_to_wait:
            return
        try:
            request = next(self.requests)
        except StopIteration:
            self.exhausted = True
            return
        if request is NOT_NOW:
            self.told_to_wait = True
            return
        self.started += 1
        workdir = self.folder / f"run-{self.started}"
        workdir.mkdir()
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            worker.send(request, workdir, self.timeout)


def usable_cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
