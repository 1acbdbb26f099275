"""Worker processes: each loads the model once, then answers one request after another until its pipe closes.

Above what such a process does; then the slot that starts one and keeps it from run to run; below the folders in which
runs are made. Each driver removes the folders of drivers that were killed: the name of a folder identifies its owner,
the machine, the process, and the start of the process, since process numbers are reused.
"""

import contextlib
import ctypes
import hashlib
import math
import os
import pickle
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing import Pipe, spawn
from multiprocessing.connection import Connection
from pathlib import Path
from typing import cast

from strandline.foundations import InvalidInput, end_of, how_it_ended, require, unfit
from strandline.models import ForwardModel
from strandline.runs.ledger.overview import exists
from strandline.runs.ledger.record import RunRecord, RunRequest, State, attempt, with_log

Wanted = Callable[[], bool]
READY, UNUSABLE = "ready", "unusable"
_loading = threading.Event()
"""Set while this process is a worker that runs the user's script to find the model."""


def main(descriptor: int, setup: str) -> None:
    """Serve the driver at the other end of the socket `descriptor`; `setup` is the file it left for its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    _die_with_driver()
    os.set_inheritable(descriptor, False)
    with Connection(descriptor) as connection, contextlib.suppress(EOFError, BrokenPipeError, ConnectionResetError):
        try:
            model = _load(Path(setup))
        except (Exception, SystemExit):
            connection.send((UNUSABLE, traceback.format_exc()))
            return
        connection.send((READY, ""))
        _serve(connection, model)


def _serve(connection: Connection, model: ForwardModel) -> None:
    """Answer requests until the driver hangs up."""
    while True:
        request, workdir = connection.recv()
        with contextlib.suppress(OSError):  # the log is opened for appending: it can be emptied here or from outside
            os.ftruncate(1, 0)
        record = attempt(model, request, Path(workdir))
        _flush()
        connection.send(record)


def _load(setup: Path) -> ForwardModel:
    """Return the model; if it is defined in the driver's script, run that script as ``__mp_main__`` first."""
    preparation, model = pickle.loads(setup.read_bytes())
    if preparation is not None:
        _loading.set()
        spawn.prepare(preparation)
        _loading.clear()
    return cast(ForwardModel, pickle.loads(model))


def _die_with_driver() -> None:
    """Arrange for this process and its children to be killed when the driver is gone.

    The driver holds the other end of the standard input and never writes to it, so the only thing that can happen there
    is that it closes. On Linux the kernel then kills the process group, whatever the simulator is doing; elsewhere a
    thread does so when it next gets to run.
    """
    lifeline = os.dup(0)
    empty = os.open(os.devnull, os.O_RDONLY)
    os.dup2(empty, 0)
    os.close(empty)
    if sys.platform == "linux":
        import fcntl

        fcntl.fcntl(lifeline, fcntl.F_SETOWN, -os.getpgid(0))
        fcntl.fcntl(lifeline, fcntl.F_SETSIG, signal.SIGKILL)
        fcntl.fcntl(lifeline, fcntl.F_SETFL, fcntl.fcntl(lifeline, fcntl.F_GETFL) | os.O_ASYNC)
    else:
        threading.Thread(target=_kill_after, args=(lifeline,), daemon=True).start()


def _kill_after(lifeline: int) -> None:
    os.read(lifeline, 1)
    os.killpg(0, signal.SIGKILL)


def _flush() -> None:
    """Flush the buffers of Python and C, so that the output lands in the log of its own run."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(Exception):
            stream.flush()
    ctypes.CDLL(None).fflush(None)


def packed_model(model: ForwardModel) -> bytes:
    """Return what a worker needs to load `model`; refuse a model that cannot be sent."""
    require_not_loading()
    try:
        packed = pickle.dumps(model)
    except Exception as error:
        what = "the model cannot be sent to worker processes"
        expected = "a function or dataclass defined at the top level of a module, with fields that can be pickled"
        remedy = "Move the model to the top level of a module (no lambda, no inner function), or use InProcess()."
        raise InvalidInput(what, value=f"{type(error).__name__}: {error}", expected=expected, remedy=remedy) from error
    preparation = None
    if b"__main__" in packed:
        preparation = spawn.get_preparation_data("strandline-worker")
        preparation.pop("authkey", None)
    return pickle.dumps((preparation, packed))


def require_not_loading() -> None:
    """Refuse to start workers from a worker that is only looking for the model in the user's script."""
    what = "worker processes were asked for while a worker was loading the script that defines the model"
    expected = "runs started under `if __name__ == '__main__':`"
    remedy = "Put the code that starts the runs under that line, or the model into a module of its own."
    require(not _loading.is_set(), what, "a script without a guard", expected, remedy)


def require_posix() -> None:
    """Refuse worker processes on a system that has no process groups."""
    require(os.name == "posix", "worker processes", os.name, "Linux or macOS", "Use InProcess(), or run under WSL.")


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

    def start(self, *, wanted: Wanted) -> bool:
        """Return whether a worker process has loaded the model (else InvalidInput); False if no longer `wanted`."""
        return self._ready_worker(wanted) is not None

    def run(self, request: RunRequest, timeout: float | None, *, wanted: Wanted) -> RunRecord | None:
        """Return the outcome of a run; None if it is no longer `wanted` before it begins.

        If it is no longer wanted after it has begun, it is stopped within half a second, as out of time; after
        `timeout` seconds, it is killed. Raises InvalidInput if the worker process cannot load the model.
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

    def _answer(self, worker: _Worker, timeout: float | None, wanted: Wanted) -> RunRecord | tuple[State, str, str]:
        """Return the record that the worker sends, or how it ended; then it is killed."""
        began = time.monotonic()
        while wanted():
            left = LOOKED_AFTER_SECONDS if timeout is None else began + timeout - time.monotonic()
            if worker.connection.poll(max(0.0, min(LOOKED_AFTER_SECONDS, left))):
                with contextlib.suppress(EOFError, OSError):
                    return cast(RunRecord, worker.connection.recv())
            elif left <= 0.0:
                break
            elif not worker.gone():
                continue
            how = how_it_ended(_ended(worker))
            return "killed", "worker_died", f"the worker process of this run ended with {how}"
        worker.kill()
        seconds = min(time.monotonic() - began, timeout or math.inf)
        return "timeout", "timeout", f"still running after {seconds:g} s, and killed"

    def _ready_worker(self, wanted: Wanted) -> _Worker | None:
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
            what = "worker processes are killed before they have loaded the model"
            expected = "workers that run until they are asked to stop"
            remedy = "Look for what kills them (memory?), or use fewer workers."
            require(killed <= KILLED_STARTS_BORNE, what, f"{killed} times", expected, remedy)
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
    what, expected = "a worker process could not load the model", "a model that a fresh interpreter can import"
    remedy = "If the model is defined in a script, start the runs under `if __name__ == '__main__':`; "
    remedy += "in a notebook, put the model into a module of its own. InProcess() needs neither."
    error = unfit(what, last, expected, remedy)
    error.add_note(f"Output of the worker:\n{text.strip()[-4000:]}")
    return error


PREFIX = "strandline-runs-"
NAME = re.compile(PREFIX + r"(?P<machine>[0-9a-f]{8})-(?P<pid>\d+)-(?P<begun>\d+)-")


def scratch_folder() -> Path:
    """Return a new, empty folder for this process; remove the folders of processes that are gone first."""
    clear_stale(Path(tempfile.gettempdir()))
    pid = os.getpid()
    return Path(tempfile.mkdtemp(prefix=f"{PREFIX}{_machine()}-{pid}-{_begun(pid) or 0}-"))


def clear_stale(parent: Path) -> None:
    """Remove the folders in `parent` whose process was on this machine and is gone."""
    names = list[str]()
    with contextlib.suppress(OSError):
        names = os.listdir(parent)  # noqa: PTH208
    for name in names:
        found = NAME.match(name)
        if found is None or found["machine"] != _machine():
            continue
        pid, begun = int(found["pid"]), int(found["begun"])
        if exists(pid) and _begun(pid) in (None, begun):  # a later process of this number does not count
            continue
        folder = parent / name
        with contextlib.suppress(OSError):  # another driver may have just removed it
            if not folder.is_symlink() and folder.is_dir() and folder.stat().st_uid == os.getuid():
                shutil.rmtree(folder, ignore_errors=True)


def _begun(pid: int) -> int | None:
    """Return when a process was started, in clock ticks since boot; None if the system does not report it."""
    if sys.platform != "linux":
        return None
    try:
        return int(Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[19])
    except (OSError, ValueError, IndexError):
        return None


def _machine() -> str:
    """Return a short name of this machine; a container with its own process numbers counts as another machine."""
    try:
        numbers = os.readlink("/proc/self/ns/pid")  # noqa: PTH115
    except OSError:
        numbers = ""
    return hashlib.sha256(f"{socket.gethostname()} {numbers}".encode()).hexdigest()[:8]
