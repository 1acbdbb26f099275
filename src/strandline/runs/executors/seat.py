"""A place where runs are made one after the other, in a worker process that is kept from run to run."""

import contextlib
import shutil
import time
from collections.abc import Callable

from strandline.errors import InvalidInput
from strandline.runs.record import RunRecord, RunRequest
from strandline.runs.scratch import scratch_folder
from strandline.runs.workers import Worker

LONGEST_WAIT_SECONDS = 0.5
"""Time after which a worker that has said nothing is checked."""
KILLED_STARTS_BORNE = 10
"""Number of worker processes that may be killed while they start."""


class Seat:
    """One worker process on this machine, replaced if a run takes it down; `close` it at the end."""

    def __init__(self, setup: bytes) -> None:
        self.folder = scratch_folder()
        self.setup = self.folder / "model.pickle"
        self.setup.write_bytes(setup)
        self.worker: Worker | None = None
        self.launched = self.runs = 0

    def start(self, *, wanted: Callable[[], bool]) -> bool:
        """Start the worker process; return True once it has loaded the model, False if it is no longer `wanted`.

        Raises:
            InvalidInput: the worker process cannot load the model.
        """
        return self._ready_worker(wanted) is not None

    def run(self, request: RunRequest, timeout: float | None, *, wanted: Callable[[], bool]) -> RunRecord | None:
        """Return the outcome of a run; None if it is no longer `wanted` before it begins.

        If it is no longer wanted after it has begun, it is stopped within half a second, as out of time.

        Raises:
            InvalidInput: the worker process cannot load the model.
        """
        worker = self._ready_worker(wanted)
        if worker is None:
            return None
        self.runs += 1
        workdir = self.folder / f"run-{self.runs}"
        workdir.mkdir()
        try:
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                worker.send(request, workdir, timeout)
            return self._answer(worker, timeout, wanted)
        finally:
            shutil.rmtree(workdir, ignore_errors=True)

    def close(self) -> None:
        """End the worker process, whatever it is doing, and remove its folder."""
        self._drop()
        shutil.rmtree(self.folder, ignore_errors=True)

    def _ready_worker(self, wanted: Callable[[], bool]) -> Worker | None:
        """Return a worker that has loaded the model; None if it is no longer wanted."""
        if self.worker is not None and self.worker.gone():
            self._drop()
        killed = 0
        while wanted():
            worker = self.worker or self._launch()
            if worker.ready:
                return worker
            if worker.connection.poll(LONGEST_WAIT_SECONDS):
                with contextlib.suppress(EOFError, OSError):
                    worker.receive()
                    continue
            elif not worker.gone():
                continue
            worker.vanished()
            self._drop()
            killed += 1
            if killed > KILLED_STARTS_BORNE:
                raise killed_while_starting(killed)
        return None

    def _launch(self) -> Worker:
        self.launched += 1
        self.worker = Worker.launch(self.folder, self.launched, self.setup)
        return self.worker

    def _answer(self, worker: Worker, timeout: float | None, wanted: Callable[[], bool]) -> RunRecord | None:
        while wanted():
            left = LONGEST_WAIT_SECONDS if worker.deadline is None else worker.deadline - time.monotonic()
            if worker.connection.poll(max(0.0, min(LONGEST_WAIT_SECONDS, left))):
                try:
                    return worker.receive()
                except (EOFError, OSError):
                    return self._lost(worker.vanished())
            if worker.overdue():
                return self._lost(worker.out_of_time(timeout or 0.0))
            if worker.gone() and not worker.connection.poll():
                return self._lost(worker.vanished())
        return self._lost(worker.out_of_time(time.monotonic() - worker.began))

    def _lost(self, record: RunRecord | None) -> RunRecord | None:
        self._drop()
        return record

    def _drop(self) -> None:
        if self.worker is not None:
            self.worker.hang_up()
            self.worker.end(time.monotonic() + 1.0)
            self.worker = None


def killed_while_starting(times: int) -> InvalidInput:
    """Return the error of worker processes that never finish starting."""
    return InvalidInput(
        "worker processes are killed before they have loaded the model",
        value=f"{times} times",
        expected="workers that run until they are asked to stop",
        remedy="Look for what kills them (memory?), or use fewer workers.",
    )
