"""A driver's hold on its ledger: the file is still in its place, and no other driver has taken over."""

import os
import sqlite3
from pathlib import Path

from filelock import BaseFileLock, FileLock, Timeout

from strandline.foundations import LedgerError
from strandline.runs.ledger.ledger_schema import last_driver

GRACE = 0.5  # seconds in which a process that a killed driver was just starting lets go of its lock


def locked(path: Path) -> BaseFileLock:
    """Acquire and return the driver's lock on a ledger; refuse if another holds it, or the folder is not writable."""
    lock = FileLock(path.with_suffix(".lock"))
    try:
        path.parent.resolve(strict=True)  # the lock would create a missing folder
        lock.acquire(timeout=GRACE)
    except Timeout:
        found = f"another run is using it, {last_driver(path)}"
        remedy = "Wait for the other run to end, or stop it; finished runs are kept."
        raise LedgerError(f"{path} is locked", value=found, expected="one driver at a time", remedy=remedy) from None
    except OSError as error:
        what = f"folder of {path} cannot be written"
        remedy = "Create the folder or correct its permissions; read_only=True reads without writing."
        raise LedgerError(what, value=str(error), expected="an existing, writable folder", remedy=remedy) from error
    return lock


class Hold:
    """The lock of the driver that opened the ledger at `path`, and the identity of both files at that time.

    A lock keeps others out only as long as its file exists: if somebody deletes it, a second driver can lock a new file
    of that name. A database file that is deleted or moved can still be written to, but nobody will find it again.
    """

    def __init__(self, path: Path, lock: BaseFileLock) -> None:
        self.path, self._lock = path, lock
        self._lock_path = Path(lock.lock_file)
        self._file, self._lock_file = _identity(path), _identity(self._lock_path)

    def require(self, connection: sqlite3.Connection, session: int) -> None:
        """Raise LedgerError if the ledger was deleted, moved or replaced, or another driver's session has begun."""
        if _identity(self.path) != self._file:
            what = f"ledger {self.path} is not the file that this run opened"
            found = "deleted, moved or replaced" if self.path.exists() else "deleted or moved"
            remedy = "Put it back and run again; it holds the runs that ended before."
            raise LedgerError(what, value=found, expected="the ledger in its place until the run ends", remedy=remedy)
        if _identity(self._lock_path) != self._lock_file:
            self._lock_again(connection, session)

    def release(self) -> None:
        """Let the next driver in."""
        self._lock.release()

    def _lock_again(self, connection: sqlite3.Connection, session: int) -> None:
        """Lock the file that now has the lock's name; refuse if another driver was quicker."""
        lock = FileLock(self._lock_path)
        try:
            lock.acquire(timeout=0)
        except (Timeout, OSError):
            raise _taken_over(self.path) from None
        (newest,) = connection.execute("SELECT max(session) FROM sessions").fetchone()
        if newest != session:
            lock.release()
            raise _taken_over(self.path)
        self._lock.release()
        self._lock, self._lock_file = lock, _identity(self._lock_path)


def _identity(path: Path) -> tuple[int, int] | None:
    """Return the device and inode number of a file; None if it does not exist."""
    try:
        found = os.stat(path)  # noqa: PTH116
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _taken_over(path: Path) -> LedgerError:
    found = f"its lock file was deleted, and {last_driver(path)} opened it"
    expected = "one driver at a time, and its lock file in its place"
    remedy = "Let the other run go on, or stop it and run again: finished runs are in the ledger."
    return LedgerError(f"another driver took over the ledger {path}", value=found, expected=expected, remedy=remedy)
