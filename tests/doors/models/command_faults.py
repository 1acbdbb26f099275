"""Simulators that misbehave, each run as a command in one campaign together with well-behaved ones; tests run them."""

import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from strandline.models.command.model import CommandModel
from strandline.readers import Reading

TIMEOUT, GRACE = 3.0, 0.5
MARKER = "STRANDLINE_FAULT"

SIMULATOR = """
import os, signal, sys, time

GOOD = "x,y\\n" + "".join(f"{k},{k * k}\\n" for k in range(5))

def write(text=GOOD, name="interface.csv"):
    with open(name, "w") as file:
        file.write(text)

def orphan(*, session=False, twice=False):
    # Leave a process behind that ignores SIGTERM, and return in the one that was started.
    if os.fork() == 0:
        if session:
            os.setsid()
        if twice and os.fork() != 0:
            os._exit(0)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        time.sleep(600)
        os._exit(0)

fault = sys.argv[1]
print("this is", fault, flush=True)
"""


@dataclass(frozen=True)
class Fault:
    """What the simulator does, its code after `SIMULATOR`, and state and failure's kind, if any, of the record."""

    what: str
    code: str
    state: str
    kind: str | None


FAULTS: Sequence[Fault] = (
    Fault("behaves", "write()", "ok", None),
    Fault("raises an exception", "raise RuntimeError('diverged')", "failed", "exit_code"),
    Fault("crashes with a segmentation fault", "os.kill(os.getpid(), signal.SIGSEGV)", "failed", "exit_code"),
    Fault("is killed from outside", "os.kill(os.getpid(), signal.SIGKILL)", "killed", "simulator_killed"),
    Fault(  # after a wait, so that the log has what was printed
        "takes its supervisor along",
        "time.sleep(0.5); os.kill(os.getppid(), signal.SIGKILL)",
        "killed",
        "supervisor_died",
    ),
    Fault("ends with exit code 77, its result written", "write(); sys.exit(77)", "failed", "exit_code"),
    Fault("hangs", "time.sleep(600)", "timeout", "timeout"),
    Fault(
        "hangs and ignores SIGTERM",
        "signal.signal(signal.SIGTERM, signal.SIG_IGN)\nwhile True: time.sleep(600)",
        "timeout",
        "timeout",
    ),
    Fault("stops itself", "os.kill(os.getpid(), signal.SIGSTOP)", "timeout", "timeout"),
    Fault("forks a child, and both hang", "orphan(); time.sleep(600)", "timeout", "timeout"),
    Fault("forks twice into a new session, and hangs", "orphan(session=True, twice=True); time.sleep(600)",
          "timeout", "timeout"),
    Fault("leaves a child that hangs, its result written", "orphan(); write()", "ok", None),
    Fault("leaves a daemon in a session of its own", "orphan(session=True, twice=True); write()", "ok", None),
    Fault("leaves a fork bomb of 30", "write()\nfor _ in range(30): orphan(session=True)", "ok", None),
    Fault("ends without a result", "pass", "invalid", "result_missing"),
    Fault("writes its result after its end", "if os.fork() == 0:\n    time.sleep(1.0)\n    write()\n    os._exit(0)",
          "invalid", "result_missing"),
    Fault("writes half of its result", "write(GOOD[: len(GOOD) // 2])", "invalid", "result_unreadable"),
    Fault("writes an empty file", "write('')", "invalid", "result_unreadable"),
    Fault("writes bytes at random", "open('interface.csv', 'wb').write(bytes(range(256)) * 9)",
          "invalid", "result_unreadable"),
    Fault("writes NaN", "write(GOOD.replace('9', 'nan'))", "invalid", "non_finite"),
    Fault("writes infinity", "write(GOOD.replace('9', '-inf'))", "invalid", "non_finite"),
    Fault("writes a point twice", "write(GOOD.replace('1,1', '0,0'))", "invalid", "invalid_interface"),
    Fault("leaves a result of 1970", "write(); os.utime('interface.csv', (0, 0))", "invalid", "result_old"),
    Fault("leaves a link to a file elsewhere", "os.symlink('/etc/hostname', 'interface.csv')",
          "invalid", "result_unreadable"),
    Fault("leaves a pipe for its result", "os.mkfifo('interface.csv')", "invalid", "result_unreadable"),
    Fault("leaves a folder for its result", "os.mkdir('interface.csv')", "invalid", "result_unreadable"),
    Fault("prints 100 MB", "write()\nfor _ in range(100): sys.stdout.write('x' * 999_999 + '\\n')\nprint('the end')",
          "ok", None),
    Fault("prints 100 MB in one line, and fails", "for _ in range(100): sys.stderr.write('y' * 1_000_000)\nsys.exit(3)",
          "failed", "exit_code"),
    Fault("is not there", "", "failed", "command_not_found"),
    Fault("has a template that divides by zero", "", "failed", "template"),
    Fault("behaves, after all these", "write()", "ok", None),
)  # fmt: skip


def study(folder: Path, marker: str) -> CommandModel:
    """Write the simulators into `folder` and return the model; its only input is the number of a fault."""
    names = [fault.what for fault in FAULTS]
    cases = "\n".join(
        f"if fault == '{k}':\n" + "\n".join(f"    {line}" for line in (fault.code or "pass").splitlines())
        for k, fault in enumerate(FAULTS)
    )
    (folder / "simulator.py").write_text(SIMULATOR + cases + "\n")
    absent, zero = names.index("is not there"), names.index("has a template that divides by zero")
    (folder / "input.j2").write_text(f"{{{{ 1 / (fault - {zero}) }}}}\n")
    return CommandModel(
        command=[f"{{{{ python if fault != {absent} else 'no-such-program' }}}}", "simulator.py", "{{ fault | int }}"],
        templates={"input.j2": "input.txt"},
        files=["simulator.py"],
        environment={MARKER: f"{marker}-{{{{ fault | int }}}}-"},
        result=Reading("interface.csv", "mm", count=5),
        timeout=TIMEOUT,
        grace=GRACE,
        keep="all",
        folder=folder,
    )


def processes_with(marker: str) -> list[int]:
    """Return the processes, except this one, that have `marker` in their environment."""
    found = []
    for path in Path("/proc").glob("[0-9]*/environ"):
        try:
            if marker.encode() in path.read_bytes() and int(path.parent.name) != os.getpid():
                found.append(int(path.parent.name))
        except OSError:
            continue
    return found


def zombies() -> list[int]:
    """Return the children of this process that have ended but were not reaped."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, parent = path.read_text().rpartition(")")[2].split()[:2]
        except OSError:
            continue
        if state == "Z" and int(parent) == os.getpid():
            found.append(int(path.parent.name))
    return found


def left_after(marker: str, patience: float = 0.0) -> Mapping[int, int]:
    """Return how many processes of each fault are left, after waiting at most `patience` seconds for them to end."""
    until = time.monotonic() + patience
    while processes_with(f"{marker}-") and time.monotonic() < until:
        time.sleep(0.05)
    return {k: len(processes_with(f"{marker}-{k}-")) for k in range(len(FAULTS))}
