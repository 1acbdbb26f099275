"""The SQLite journal of a ledger: a write-ahead log on a local disk, a rollback journal on a network disk.

A write-ahead log needs memory shared by all processes, which processes on several machines do not have and network file
systems do not offer reliably. A rollback journal only needs file locks. Linux reports which file system a folder is on;
elsewhere `STRANDLINE_JOURNAL` decides. Standard library only.
"""

import contextlib
import os
import re
import sqlite3
from collections.abc import Mapping
from pathlib import Path
from typing import Literal, cast

from strandline.foundations import LedgerError, require

Journal = Literal["wal", "delete"]
VARIABLE = "STRANDLINE_JOURNAL"
"""Environment variable: ``wal`` or ``delete``, whatever disk the ledger is on."""
MOUNTS = Path("/proc/self/mountinfo")
NETWORK = re.compile(
    r"nfs4?|lustre|gpfs|mmfs|cifs|smb2|smb3|smbfs|ncpfs|davfs|9p|virtiofs|vboxsf|afs|acfs|coda|ceph|glusterfs|gfs2?|ocfs2|"
    r"beegfs|fhgfs|panfs|pvfs2|orangefs|wekafs|fuse(\..*)?"
)
"""Types of file systems that several machines may write to; all of FUSE counts, since sshfs and rclone use it."""
BUSY_SECONDS = 120.0
"""Seconds that a driver waits for readers, which block writes to a ledger with a rollback journal."""
ROLLBACK = 1
FORMAT_BYTE = 18
"""Byte of a database file: 1 with a rollback journal, 2 with a write-ahead log."""


def journal_for(path: Path, *, environment: Mapping[str, str] | None = None, mounts: Path | None = None) -> Journal:
    """Return which journal the ledger at `path` should have; refuse an environment that says neither wal nor delete."""
    asked = (os.environ if environment is None else environment).get(VARIABLE, "")
    if not asked:
        return "delete" if is_network(file_system(path, mounts=mounts)) else "wal"
    what, remedy = f"{VARIABLE} in the environment", "Unset it to let the file system decide."
    require(asked in ("wal", "delete"), what, asked, "wal or delete", remedy)
    return cast(Journal, asked)


def note(path: Path, *, mounts: Path | None = None) -> str | None:
    """Return a line for the user of a study if its ledger at `path` has a rollback journal; else None."""
    if journal_for(path, mounts=mounts) == "wal":
        return None
    kind = file_system(path, mounts=mounts)
    why = f"lies on a network file system ({kind})" if is_network(kind) else f"follows {VARIABLE}=delete"
    return f"the ledger {why}: a rollback journal keeps it safe there; each write takes a little longer"


def is_network(kind: str | None) -> bool:
    """Return whether several machines may write to a file system of this type."""
    return kind is not None and NETWORK.fullmatch(kind) is not None


def file_system(path: Path, *, mounts: Path | None = None) -> str | None:
    """Return the type of the file system that `path` is on; None if the system does not report it."""
    try:
        lines = (mounts or MOUNTS).read_text("utf-8", "surrogateescape").splitlines()
    except OSError:
        return None
    place, found, longest = path.parent.resolve(), None, -1
    for line in lines:
        before, _, after = line.partition(" - ")
        columns = before.split(" ")
        if len(columns) > 4 and after:
            point = Path(re.sub(r"\\([0-7]{3})", lambda code: chr(int(code[1], 8)), columns[4]))
            if place.is_relative_to(point) and len(point.parts) >= longest:  # if equal, the last covers the others
                found, longest = after.split(" ")[0], len(point.parts)
    return found


def settle(connection: sqlite3.Connection, path: Path, *, busy_seconds: float = BUSY_SECONDS) -> None:
    """Give the ledger at `path` its journal before `connection` has read it; refuse to convert one that others read."""
    if journal_for(path) == "wal":
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = FULL")
        return
    connection.execute(f"PRAGMA busy_timeout = {int(1000 * busy_seconds)}")
    connection.execute("PRAGMA locking_mode = EXCLUSIVE")  # to read a write-ahead log without shared memory
    try:
        connection.execute("PRAGMA journal_mode = DELETE")
    except sqlite3.OperationalError as error:
        if "locked" not in str(error):
            raise
        what = f"ledger {path} cannot be given a rollback journal, which it needs on this disk"
        found, expected = "a ledger that another program is reading", "no other program using it for a moment"
        raise LedgerError(what, value=found, expected=expected, remedy="Wait until it ends, and run again.") from None
    connection.execute("PRAGMA locking_mode = NORMAL")
    connection.execute("PRAGMA synchronous = EXTRA")
    connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()  # releases the lock


def has_rollback_journal(path: Path) -> bool:
    """Return whether the ledger at `path` has a rollback journal."""
    with contextlib.suppress(OSError), path.open("rb") as file:
        file.seek(FORMAT_BYTE)
        return file.read(1) == bytes([ROLLBACK])
    return False
