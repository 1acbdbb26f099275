"""A place where runs are made one after the other, in a worker process that is kept from run to run."""

import contextlib
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection

from strandline.foundations import InvalidInput, end_of, how_it_ended
from strandline.runs.ledger.record import RunRecord, RunRequest, State, with_log
from strandline.runs.ledger.scratch import scratch_folder
from strandline.runs.worker import UNUSABLE

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)
LOOKED_AFTER_SECONDS = 0.25
"""Time after which a worker that has said nothing is checked."""
KILLED_STARTS_BORNE = 10
"""Number of worker processes that may be killed while they start."""


@dataclass(eq=False)
class _Worker:
    """A worker process and our end of its pipe; `ready` once it has loaded the model."""

    process: subprocess.Popen[bytes]
    connection: Connection
    ready: bool = False

    def gone(self) -> bool:
        """Return whether the process has ended and has said nothing more."""
        return self.process.poll() is not None and not self.connection.poll()

    def kill(self) -> None:
        """Kill the process and everything that it started in its group, then reap it."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()


class WorkerSlot:
    """One worker process on this machine, replaced if a run takes it down; `close` it at the end.

    The process is a fresh interpreter that computes on one thread and starts with the first run, or with `start`. It
    loads the model from `packed_model`. Only one thread at a time may use a slot.
    """

    def __init__(self, setup: bytes) -> None:
        self._folder = scratch_folder()
        self._setup, self._log = self._folder / "model.pickle", self._folder / "worker.log"
        self._setup.write_bytes(setup)
        self._worker: _Worker | None = None
        self._runs = 0

    def start(self, *, wanted: Callable[[], bool]) -> bool:
        """Start the worker process; return True once it has loaded the model, False if it is no longer `wanted`.

        Raises:
            InvalidInput: the worker process cannot load the model.
        """
        return self._ready_worker(wanted) is not None

    def run(self, request: RunRequest, timeout: float | None, *, wanted: Callable[[], bool]) -> RunRecord | None:
        """Return the outcome of a run; None if it is no longer `wanted` before it begins.

        If it is no longer wanted after it has begun, it is stopped within half a second, as out of time; after
        `timeout` seconds, it is killed.

        Raises:
            InvalidInput: the worker process cannot load the model.
        """
        worker = self._ready_worker(wanted)
        if worker is None:
            return None
        self._runs += 1
        workdir = self._folder / f"run-{self._runs}"
        workdir.mkdir()
        began = time.monotonic()
        try:
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                worker.connection.send((request, str(workdir)))
            ended = self._answer(worker, timeout, wanted)
        finally:
            shutil.rmtree(workdir, ignore_errors=True)
        if not isinstance(ended, RunRecord):
            self._drop()
            (state, kind, message), seconds = ended, time.monotonic() - began
            ended = RunRecord(request.key, request.inputs, state, seconds=seconds, failure_kind=kind, message=message)
        return with_log(ended, end_of(self._log))

    def close(self) -> None:
        """End the worker process, whatever it is doing, and remove its folder."""
        self._drop()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _answer(
        self, worker: _Worker, timeout: float | None, wanted: Callable[[], bool]
    ) -> RunRecord | tuple[State, str, str]:
        """Return the record that the worker sends, or how it ended; then it is killed."""
        began = time.monotonic()
        while wanted():
            left = LOOKED_AFTER_SECONDS if timeout is None else began + timeout - time.monotonic()
            if worker.connection.poll(max(0.0, min(LOOKED_AFTER_SECONDS, left))):
                with contextlib.suppress(EOFError, OSError):
                    record: RunRecord = worker.connection.recv()
                    return record
            elif left <= 0.0:
                break
            elif not worker.gone():
                continue
            how = how_it_ended(_ended(worker))
            return "killed", "worker_died", f"the worker process of this run ended with {how}"
        worker.kill()
        seconds = min(time.monotonic() - began, timeout or math.inf)
        return "timeout", "timeout", f"still running after {seconds:g} s, and killed"

    def _ready_worker(self, wanted: Callable[[], bool]) -> _Worker | None:
        """Return a worker that has loaded the model; None if it is no longer wanted."""
        if self._worker is not None and self._worker.process.poll() is not None:
            self._drop()
        killed = 0
        while wanted():
            worker = self._worker or self._launch()
            if worker.ready:
                return worker
            if worker.connection.poll(LOOKED_AFTER_SECONDS):
                with contextlib.suppress(EOFError, OSError):
                    word, text = worker.connection.recv()
                    if word == UNUSABLE:
                        raise _unusable(text)
                    worker.ready = True
                    continue
            elif not worker.gone():
                continue
            code = _ended(worker)
            if code != -signal.SIGKILL:
                raise _unusable(f"the worker process ended with {how_it_ended(code)}\n{end_of(self._log)}")
            self._drop()
            killed += 1
            if killed > KILLED_STARTS_BORNE:
                raise InvalidInput(
                    "worker processes are killed before they have loaded the model",
                    value=f"{killed} times",
                    expected="workers that run until they are asked to stop",
                    remedy="Look for what kills them (memory?), or use fewer workers.",
                )
        return None

    def _launch(self) -> _Worker:
        """Start and return a worker in its own session and process group: this interpreter with its search path."""
        ours, theirs = Pipe()
        code = (
            f"import sys; sys.path[:] = {sys.path!r}; "
            f"from strandline.runs.worker import main; main({theirs.fileno()}, {str(self._setup)!r})"
        )
        with theirs, self._log.open("ab") as output, interrupts_held_back():
            output.truncate(0)
            process = subprocess.Popen(
                [sys.executable, "-X", "faulthandler", "-u", "-c", code],
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=subprocess.STDOUT,
                env={**os.environ, **ONE_THREAD},
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )
        self._worker = _Worker(process, ours)
        return self._worker

    def _drop(self) -> None:
        """Let an idle worker end by itself within a second, and kill any other."""
        worker, self._worker = self._worker, None
        if worker is None:
            return
        worker.connection.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            worker.process.wait(1.0 if worker.ready else 0.0)
        worker.kill()
        if worker.process.stdin is not None:
            worker.process.stdin.close()


@contextlib.contextmanager
def interrupts_held_back() -> Iterator[None]:
    """Make processes started inside ignore Ctrl-C from the start; this process receives it afterwards."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _ended(worker: _Worker) -> int | None:
    """Return the exit code of a worker that has hung up, and kill what it started."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        worker.process.wait(1.0)
    worker.kill()
    return worker.process.returncode


def _unusable(text: str) -> InvalidInput:
    """Return the error of a model that no worker can load."""
    last = text.strip().splitlines()[-1] if text.strip() else "no output"
    error = InvalidInput(
        "a worker process could not load the model",
        value=last,
        expected="a model that a fresh interpreter can import",
        remedy="If the model is defined in a script, start the runs under `if __name__ == '__main__':`; "
        "in a notebook, put the model into a module of its own. InProcess() needs neither.",
    )
    error.add_note(f"Output of the worker:\n{text.strip()[-4000:]}")
    return error
