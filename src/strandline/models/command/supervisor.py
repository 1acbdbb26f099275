"""The program that runs one command of a simulator and is responsible for every process that it starts.

It runs between the worker and the simulator, in its own session, and imports only the standard library:

- it reads one line of JSON from its standard input and keeps the input open: when that closes, the worker is gone, and
  all processes of the simulator are killed;
- it adopts the processes that the simulator leaves behind (Linux: ``PR_SET_CHILD_SUBREAPER``), including those that
  fork twice or open their own session, and reaps them;
- it keeps the first and the last part of their output;
- it writes one line of JSON to its standard output: how the command ended.
"""

import collections
import contextlib
import ctypes
import json
import os
import select
import signal
import sys
import time

PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36
LINUX = sys.platform == "linux"
GIVEN_UP_AFTER = 10.0
"""Seconds after which a process that survives SIGKILL (it hangs in the kernel) is given up."""
TAIL_REPORTED = 8192
CHUNK = 65536
LONGEST_POLL = 3600.0
"""Seconds; poll() accepts at most 2³¹ milliseconds, 24.8 days."""


class Log:
    """The command's output: the first and the last `limit` bytes go to a file."""

    def __init__(self, path: str, limit: int) -> None:
        self.file = open(path, "wb", buffering=0)  # noqa: SIM115, PTH123
        self.limit, self.total, self.kept = limit, 0, 0
        self.pieces: collections.deque[bytes] = collections.deque()

    def add(self, data: bytes) -> None:
        """Add the next piece of output."""
        head = data[: max(0, self.limit - self.total)]
        if head:
            self._write(head)
        self.total += len(data)
        self.kept += len(data)
        self.pieces.append(data)
        while self.kept - len(self.pieces[0]) > self.limit:
            self.kept -= len(self.pieces.popleft())

    def close(self) -> str:
        """Write the end of the output, and return its last part as text."""
        tail, rest = b"".join(self.pieces), min(self.total - self.limit, self.limit)
        if rest > 0:
            left_out = self.total - self.limit - rest
            self._write(f"\n[… {left_out} bytes left out …]\n".encode() if left_out else b"")
            self._write(tail[-rest:])
        self.file.close()
        return tail[-TAIL_REPORTED:].decode("utf-8", "replace")

    def _write(self, data: bytes) -> None:
        with contextlib.suppress(OSError):  # a full disk costs the log, not the run
            self.file.write(data)


class Tree:
    """The command's process and all its descendants."""

    def __init__(
        self, arguments: list[str], environment: dict[str, str], log: Log, *, longest_poll: float = LONGEST_POLL
    ) -> None:
        self.log, self.lifeline_lost, self.longest_poll = log, False, longest_poll
        self.status: int | None = None
        self.output, write_end = os.pipe()
        woken, wake = os.pipe()
        for descriptor in (self.output, woken, wake):
            os.set_blocking(descriptor, False)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
        self.woken = woken
        self.poll = select.poll()
        for descriptor in (self.output, woken, 0):
            self.poll.register(descriptor, select.POLLIN)
        self.pid = started(arguments, environment, write_end)
        os.close(write_end)

    def wait(self, deadline: float) -> None:
        """Pass on output until something happens, at most until `deadline` or for `longest_poll` seconds."""
        patience = min(max(0.0, deadline - time.monotonic()), self.longest_poll)
        for descriptor, _ in self.poll.poll(1000 * patience + 1):
            if descriptor == self.output:
                self._read()
            elif descriptor == 0:
                self.lifeline_lost = self.lifeline_lost or not os.read(0, CHUNK)
            else:
                os.read(self.woken, CHUNK)
        if self.lifeline_lost:
            with contextlib.suppress(KeyError):
                self.poll.unregister(0)

    def alive(self) -> bool:
        """Reap the processes that have ended; return whether any are left."""
        while True:
            try:
                pid, status = os.waitpid(-1, os.WNOHANG)
            except ChildProcessError:
                return False
            if pid == 0:
                return True
            if pid == self.pid:
                self.status = os.waitstatus_to_exitcode(status)

    def end(self, grace: float) -> int:
        """End all processes, first with SIGTERM; return how many could not be ended."""
        deadline = time.monotonic() + grace
        if self.alive() and not self.lifeline_lost:
            self._signal(signal.SIGTERM)
            while self.alive() and not self.lifeline_lost and time.monotonic() < deadline:
                self.wait(min(deadline, time.monotonic() + 0.05))
        deadline = time.monotonic() + GIVEN_UP_AFTER
        while self.alive() and time.monotonic() < deadline:
            self._signal(signal.SIGKILL)
            self.wait(time.monotonic() + 0.01)
        while self._read():
            pass
        return len(self._pids()) if self.alive() else 0

    def _read(self) -> bool:
        try:
            data = os.read(self.output, CHUNK)
        except BlockingIOError:
            return False
        if data:
            self.log.add(data)
        else:
            with contextlib.suppress(KeyError):
                self.poll.unregister(self.output)
        return bool(data)

    def _signal(self, number: int) -> None:
        for pid in self._pids():
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(pid, number)
        if not LINUX:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self.pid, number)

    def _pids(self) -> list[int]:
        return descendants(os.getpid()) if LINUX else [self.pid]


def descendants(root: int) -> list[int]:
    """Return the processes below `root`, parents first."""
    children: dict[int, list[int]] = {}
    for name in os.listdir("/proc"):  # noqa: PTH208
        if name.isdigit():
            with contextlib.suppress(OSError), open(f"/proc/{name}/stat", "rb") as file:  # noqa: PTH123
                parent = int(file.read().rpartition(b")")[2].split()[1])
                children.setdefault(parent, []).append(int(name))
    found, at = list(children.get(root, [])), 0
    while at < len(found):
        found += children.get(found[at], [])
        at += 1
    return found


def started(arguments: list[str], environment: dict[str, str], output: int) -> int:
    """Start the command and return its process id.

    Raises:
        OSError: it cannot be started.
    """
    told, tell = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            os.setsid()
            if LINUX:
                prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE, signal.SIGCHLD):
                signal.signal(number, signal.SIG_DFL)
            signal.pthread_sigmask(signal.SIG_SETMASK, [])
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            os.dup2(output, 1)
            os.dup2(output, 2)
            os.execvpe(arguments[0], arguments, environment)
        except OSError as error:
            os.write(tell, str(error.errno or 0).encode())
        finally:
            os._exit(127)
    os.close(tell)
    problem = os.read(told, 16)
    os.close(told)
    if problem:
        os.waitpid(pid, 0)
        raise OSError(int(problem), os.strerror(int(problem)))
    return pid


def prctl(option: int, value: int) -> None:
    """Call the C function of that name."""
    ctypes.CDLL(None).prctl(option, value, 0, 0, 0)


def request() -> dict[str, object] | None:
    """Return the worker's request; None if the worker ended before it sent one."""
    text = b""
    while not text.endswith(b"\n"):
        data = os.read(0, CHUNK)
        if not data:
            return None
        text += data
    found: dict[str, object] = json.loads(text)
    return found


def run(asked, *, longest_poll: float = LONGEST_POLL) -> dict[str, object]:  # type: ignore[no-untyped-def]
    """Run the command until it ends; return how it ended."""
    log = Log(asked["log"], asked["log_limit"])
    deadline = float("inf") if asked["timeout"] is None else time.monotonic() + asked["timeout"]
    oom_before = oom_kills()
    try:
        tree = Tree(asked["arguments"], asked["environment"], log, longest_poll=longest_poll)
    except OSError as error:
        log.close()
        return {"error": error.strerror or str(error), "errno": error.errno}
    while tree.alive() and tree.status is None and not tree.lifeline_lost and time.monotonic() < deadline:
        tree.wait(deadline)
    timed_out = tree.status is None and not tree.lifeline_lost
    left = tree.end(asked["grace"])
    return {
        "exit_code": tree.status,
        "timeout": timed_out,
        "tail": log.close(),
        "left": left,
        "out_of_memory": oom_kills() > oom_before,
    }


def oom_kills() -> int:
    """Return how many processes on this machine the kernel has killed for lack of memory; 0 if unknown."""
    with contextlib.suppress(OSError, ValueError), open("/proc/vmstat") as file:  # noqa: PTH123
        return sum(int(line.split()[1]) for line in file if line.startswith("oom_kill "))
    return 0


def main() -> None:
    """Serve one request."""
    if LINUX:
        prctl(PR_SET_CHILD_SUBREAPER, 1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    asked = request()
    if asked is not None:
        answer = json.dumps(run(asked))
        with contextlib.suppress(BrokenPipeError):
            os.write(1, answer.encode())


if __name__ == "__main__":
    main()
