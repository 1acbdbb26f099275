"""The driver's side of a worker process: start it, send it a run, report how it ended."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path

from strandline.errors import InvalidInput
from strandline.runs.record import RunRecord, RunRequest, State, with_log
from strandline.runs.worker import UNUSABLE

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)
LOG_TAIL_BYTES = 8192


@dataclass(eq=False)
class Worker:
    """A worker process; `request` is the run that it is making now."""

    process: subprocess.Popen[bytes]
    connection: Connection
    log: Path
    ready: bool = False
    request: RunRequest | None = None
    workdir: Path = Path()
    began: float = 0.0
    deadline: float | None = None

    @classmethod
    def launch(cls, folder: Path, number: int, setup: Path) -> "Worker":
        """Start and return a worker: a fresh interpreter in its own session and process group."""
        ours, theirs = Pipe()
        log = folder / f"worker-{number}.log"
        with theirs, log.open("ab") as output, interrupts_held_back():
            process = subprocess.Popen(
                _command(theirs.fileno(), setup),
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=_environment(os.environ),
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )
        return cls(process, ours, log)

    @property
    def busy(self) -> bool:
        """Whether the worker is making a run."""
        return self.request is not None

    def send(self, request: RunRequest, workdir: Path, timeout: float | None) -> None:
        """Start a run; its clock starts now."""
        self.request, self.workdir, self.began = request, workdir, time.monotonic()
        self.deadline = None if timeout is None else self.began + timeout
        self.connection.send((request, str(workdir)))

    def receive(self) -> RunRecord | None:
        """Return the record that the worker sent; None if it only said that it is ready.

        Raises:
            InvalidInput: the worker cannot load the model.
            EOFError: the worker is gone.
        """
        if self.ready:
            record: RunRecord = self.connection.recv()
            self.request = self.deadline = None
            return record if record.ok else with_log(record, self._log_tail())
        word, text = self.connection.recv()
        if word == UNUSABLE:
            raise _unusable(text)
        self.ready = True
        return None

    def overdue(self) -> bool:
        """Return whether the run has used up its time."""
        return self.deadline is not None and time.monotonic() >= self.deadline

    def gone(self) -> bool:
        """Return whether the process has ended."""
        return self.process.poll() is not None

    def out_of_time(self, timeout: float) -> RunRecord | None:
        """Kill the worker and return the record of its run, which took too long."""
        self._kill()
        return self._lost("timeout", "timeout", f"still running after {timeout:g} s, and killed")

    def vanished(self) -> RunRecord | None:
        """Return the record of the run that took the process down; None if there was no run.

        Raises:
            InvalidInput: the process ended before it had loaded the model, and nobody killed it.
        """
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(1.0)
        self._kill()
        how = _how_it_ended(self.process.returncode)
        if not self.ready and self.process.returncode != -signal.SIGKILL:
            raise _unusable(f"the worker process ended with {how}\n{self._log_tail()}")
        return self._lost("killed", "worker_died", f"the worker process of this run ended with {how}")

    def hang_up(self) -> None:
        """Let an idle worker end by itself; kill one that is busy or still starting."""
        if self.busy or not self.ready:
            self._kill()
        self.connection.close()

    def end(self, deadline: float = 0.0) -> None:
        """End the process by `deadline` (monotonic seconds) at the latest, and release what it held."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(max(0.0, deadline - time.monotonic()))
        self._kill()
        self.connection.close()
        if self.process.stdin is not None:
            self.process.stdin.close()

    def _kill(self) -> None:
        """Kill the process and everything that it started in its group, then reap it."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()

    def _lost(self, state: State, kind: str, message: str) -> RunRecord | None:
        """Return the record of a run that did not answer."""
        if self.request is None:
            return None
        seconds = time.monotonic() - self.began
        record = RunRecord(
            self.request.key, self.request.inputs, state, seconds=seconds, failure_kind=kind, message=message
        )
        return with_log(record, self._log_tail())

    def _log_tail(self) -> str:
        """Return the end of the current run's output."""
        with self.log.open("rb") as stream:
            size = stream.seek(0, os.SEEK_END)
            stream.seek(max(0, size - LOG_TAIL_BYTES))
            return stream.read().decode("utf-8", "replace")


def _command(descriptor: int, setup: Path) -> list[str]:
    """Return the command of a worker: this interpreter, its search path, tracebacks of crashes in the log."""
    code = (
        f"import sys; sys.path[:] = {sys.path!r}; "
        f"from strandline.runs.worker import main; main({descriptor}, {str(setup)!r})"
    )
    return [sys.executable, "-X", "faulthandler", "-u", "-c", code]


def _environment(own: Mapping[str, str]) -> dict[str, str]:
    """Return the workers' environment: each computes on one thread."""
    return {**own, **ONE_THREAD}


@contextlib.contextmanager
def interrupts_held_back() -> Iterator[None]:
    """Make processes started inside ignore Ctrl-C from the start; this process receives it afterwards."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _how_it_ended(code: int | None) -> str:
    if code is None or code >= 0:
        return f"exit code {code}"
    with contextlib.suppress(ValueError):
        return f"signal {signal.Signals(-code).name}"
    return f"signal {-code}"


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
