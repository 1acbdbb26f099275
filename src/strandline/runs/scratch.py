"""The folders in which runs are made; those of drivers that were killed are cleared by the next one.

The name of a folder says whose it is: the machine, the process, and when that was started, since process numbers are
reused.
"""

import hashlib
import os
import re
import shutil
import socket
import sys
import tempfile
from pathlib import Path

__all__ = ["PREFIX", "clear_stale", "scratch_folder"]

PREFIX = "strandline-runs-"
NAME = re.compile(PREFIX + r"(?P<machine>[0-9a-f]{8})-(?P<pid>\d+)-(?P<begun>\d+)-")


def scratch_folder() -> Path:
    """Return a new, empty folder of this process; those of processes that are gone are removed first."""
    clear_stale(Path(tempfile.gettempdir()))
    pid = os.getpid()
    return Path(tempfile.mkdtemp(prefix=f"{PREFIX}{_machine()}-{pid}-{_begun(pid) or 0}-"))


def clear_stale(parent: Path) -> int:
    """Remove the folders in `parent` whose process was on this machine and is gone; return how many."""
    cleared = 0
    for name in _entries(parent):
        found = NAME.match(name)
        if found is None or found["machine"] != _machine() or _lives(int(found["pid"]), int(found["begun"])):
            continue
        folder = parent / name
        if folder.is_symlink() or not folder.is_dir() or folder.stat().st_uid != os.getuid():
            continue
        shutil.rmtree(folder, ignore_errors=True)
        cleared += not folder.exists()
    return cleared


def _entries(parent: Path) -> list[str]:
    try:
        return os.listdir(parent)  # noqa: PTH208
    except OSError:
        return []


def _lives(pid: int, begun: int) -> bool:
    """Return whether the process `pid` that was started at `begun` is still there; a later one does not count."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OverflowError:
        return False
    except PermissionError:
        pass
    now = _begun(pid)
    return now is None or now == begun


def _begun(pid: int) -> int | None:
    """Return when a process was started, in ticks since the machine was; None where the system does not say."""
    if sys.platform != "linux":
        return None
    try:
        return int(Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[19])
    except (OSError, ValueError, IndexError):
        return None


def _machine() -> str:
    """Return a short name of this machine; a container with process numbers of its own is another machine."""
    try:
        numbers = os.readlink("/proc/self/ns/pid")  # noqa: PTH115
    except OSError:
        numbers = ""
    return hashlib.sha256(f"{socket.gethostname()} {numbers}".encode()).hexdigest()[:8]
