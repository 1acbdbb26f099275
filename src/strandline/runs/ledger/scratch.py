"""Folders in which runs are made; each driver removes the folders of drivers that were killed.

The name of a folder identifies its owner: the machine, the process, and the start of the process, since process numbers
are reused.
"""

import contextlib
import hashlib
import os
import re
import shutil
import socket
import sys
import tempfile
from pathlib import Path

PREFIX = "strandline-runs-"
NAME = re.compile(PREFIX + r"(?P<machine>[0-9a-f]{8})-(?P<pid>\d+)-(?P<begun>\d+)-")


def scratch_folder() -> Path:
    """Return a new, empty folder for this process; remove the folders of processes that are gone first."""
    clear_stale(Path(tempfile.gettempdir()))
    pid = os.getpid()
    return Path(tempfile.mkdtemp(prefix=f"{PREFIX}{_machine()}-{pid}-{_begun(pid) or 0}-"))


def clear_stale(parent: Path) -> int:
    """Remove the folders in `parent` whose process was on this machine and is gone; return how many."""
    cleared, names = 0, list[str]()
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
        try:
            ours = not folder.is_symlink() and folder.is_dir() and folder.stat().st_uid == os.getuid()
        except OSError:  # another driver has just removed it
            continue
        if not ours:
            continue
        shutil.rmtree(folder, ignore_errors=True)
        cleared += not folder.exists()
    return cleared


def exists(pid: int) -> bool:
    """Return whether there is a process of this number, whoever owns it."""
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    return True


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
