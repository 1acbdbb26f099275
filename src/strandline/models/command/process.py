"""The worker's side of a command: run it under a supervisor and learn how it ended."""

import contextlib
import errno
import json
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from strandline.errors import ForwardModelError

SUPERVISOR = Path(__file__).with_name("supervisor.py")
LOG_LIMIT = 1_000_000
"""Bytes kept of the beginning, and of the end, of a command's output."""
LOG_TAIL_BYTES = 8192
KILLED_IN_A_SHELL = 128 + signal.SIGKILL
"""Exit code of a shell, or a launcher such as mpirun, whose own child was killed by SIGKILL."""
SHORT_OF_MEMORY = frozenset({errno.ENOMEM, errno.EAGAIN})


@dataclass(frozen=True)
class ProcessEnd:
    """How a command ended: its exit code, minus the number of a signal; None if it never started, with the `problem`.

    `timed_out`: its time was up. `tail` is the end of its output. `out_of_memory`: the kernel killed a process during
    the run for lack of memory.
    """

    exit_code: int | None
    timed_out: bool
    tail: str
    problem: str = ""
    out_of_memory: bool = False

    @property
    def killed(self) -> bool:
        """Whether a SIGKILL from outside ended it: from an operator, the kernel or a batch system."""
        return not self.timed_out and self.exit_code in (-signal.SIGKILL, KILLED_IN_A_SHELL)

    @property
    def how(self) -> str:
        """Exit code or signal, in words."""
        if self.exit_code is None or self.exit_code >= 0:
            return f"exit code {self.exit_code}"
        with contextlib.suppress(ValueError):
            return f"signal {signal.Signals(-self.exit_code).name}"
        return f"signal {-self.exit_code}"


def supervised(
    arguments: Sequence[str],
    *,
    folder: Path,
    environment: Mapping[str, str],
    timeout: float | None,
    grace: float,
    log: Path,
) -> ProcessEnd:
    """Run a command in `folder`, without a shell, to its end; no process that it started remains afterwards.

    `environment` is complete. After `timeout` seconds (None: no limit) it is ended by SIGTERM and, `grace` seconds
    later, by SIGKILL. The file `log` gets its output, at most twice `LOG_LIMIT` bytes.

    Raises:
        ForwardModelError: ``supervisor_died`` or ``out_of_memory``, both with the state ``killed``; ``processes_left``.
    """
    asked = {
        "arguments": list(arguments),
        "environment": dict(environment),
        "timeout": timeout,
        "grace": grace,
        "log": str(log),
        "log_limit": LOG_LIMIT,
    }
    process = _started(folder, environment)
    assert process.stdin is not None
    assert process.stdout is not None
    with process.stdin, process.stdout:
        try:
            with contextlib.suppress(BrokenPipeError):
                process.stdin.write(json.dumps(asked).encode() + b"\n")
                process.stdin.flush()
            answer = process.stdout.read()
        finally:
            with contextlib.suppress(BrokenPipeError):
                process.stdin.close()
            process.wait()
    return _ended(answer, process.returncode, log)


def _started(folder: Path, environment: Mapping[str, str]) -> subprocess.Popen[bytes]:
    """Return a supervisor that waits for its request."""
    try:
        return subprocess.Popen(
            [sys.executable, "-I", "-S", str(SUPERVISOR)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            cwd=folder,
            env=dict(environment),
            start_new_session=True,
        )
    except OSError as error:
        if error.errno in SHORT_OF_MEMORY:
            raise _no_room(error.strerror or str(error)) from None
        raise


def _ended(answer: bytes, code: int, log: Path) -> ProcessEnd:
    try:
        told: dict[str, Any] = json.loads(answer)
    except ValueError:  # nothing, or the beginning of an answer
        how = ProcessEnd(code, False, "").how
        message = f"the process that watches over the simulator ended with {how}, and the simulator with it"
        raise ForwardModelError("supervisor_died", message, state="killed", log=_end_of(log)) from None
    if told.get("errno") in SHORT_OF_MEMORY:
        raise _no_room(told["error"])
    if "error" in told:
        return ProcessEnd(None, False, "", told["error"])
    if told["left"]:
        message = f"{told['left']} process(es) of the simulator survive SIGKILL"
        raise ForwardModelError("processes_left", message, log=told["tail"])
    return ProcessEnd(told["exit_code"], told["timeout"], told["tail"], out_of_memory=told["out_of_memory"])


def _no_room(reason: str) -> ForwardModelError:
    message = f"the system had no room for the simulator's process: {reason}"
    return ForwardModelError("out_of_memory", message, state="killed")


def _end_of(log: Path) -> str:
    """Return the end of the log file, for a supervisor that died and cannot report it."""
    with contextlib.suppress(OSError):
        return log.read_bytes()[-LOG_TAIL_BYTES:].decode("utf-8", "replace")
    return ""
