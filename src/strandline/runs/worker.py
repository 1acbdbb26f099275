"""What a worker process does: load the model once, then answer one request after another until its pipe closes."""

import contextlib
import ctypes
import os
import pickle
import signal
import sys
import threading
import traceback
from multiprocessing import spawn
from multiprocessing.connection import Connection
from pathlib import Path

from strandline.foundations import InvalidInput
from strandline.models import ForwardModel
from strandline.runs.ledger.record import attempt

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
        _empty_log()
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
    loaded: ForwardModel = pickle.loads(model)
    return loaded


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


def _empty_log() -> None:
    """Empty the log before this run; it is opened for appending, so it can be truncated here or from outside."""
    with contextlib.suppress(OSError):
        os.ftruncate(1, 0)


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
        raise InvalidInput(
            "the model cannot be sent to worker processes",
            value=f"{type(error).__name__}: {error}",
            expected="a function or dataclass defined at the top level of a module, with fields that can be pickled",
            remedy="Move the model to the top level of a module (no lambda, no inner function), or use InProcess().",
        ) from error
    preparation = None
    if b"__main__" in packed:
        preparation = spawn.get_preparation_data("strandline-worker")
        preparation.pop("authkey", None)
    return pickle.dumps((preparation, packed))


def require_not_loading() -> None:
    """Refuse to start workers from a worker that is only looking for the model in the user's script."""
    if _loading.is_set():
        raise InvalidInput(
            "worker processes were asked for while a worker was loading the script that defines the model",
            value="a script without a guard",
            expected="runs started under `if __name__ == '__main__':`",
            remedy="Put the code that starts the runs under that line, or the model into a module of its own.",
        )


def require_posix() -> None:
    """Refuse worker processes on a system that has no process groups."""
    if os.name != "posix":
        raise InvalidInput(
            "worker processes", value=os.name, expected="Linux or macOS", remedy="Use InProcess(), or run under WSL."
        )
