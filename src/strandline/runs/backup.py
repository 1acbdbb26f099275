"""Copies of a ledger, made by SQLite while a driver may be writing to it; standard library only."""

import contextlib
import os
import sqlite3
from itertools import count
from pathlib import Path

__all__ = ["backup_before_upgrade", "copied"]


def copied(connection: sqlite3.Connection, target: Path) -> None:
    """Copy the database of `connection` to `target`, completely or not at all.

    Raises:
        FileExistsError: The file exists already.
        sqlite3.Error: The copy cannot be written, or is not sound.
    """
    partial = target.with_name(f".{target.name}.{os.getpid()}.partial")
    try:
        with contextlib.closing(sqlite3.connect(partial, isolation_level=None)) as copy:
            connection.backup(copy)
            copy.execute("PRAGMA journal_mode = DELETE")
            (found,) = copy.execute("PRAGMA quick_check(1)").fetchone()
        if found != "ok":
            raise sqlite3.DatabaseError(found)
        _moved(partial, target)
    finally:
        partial.unlink(missing_ok=True)


def _moved(partial: Path, target: Path) -> None:
    """Give the finished copy its name without overwriting a file; some disks have no hard links."""
    try:
        os.link(partial, target)
    except FileExistsError:
        raise
    except (OSError, AttributeError):
        if target.exists():
            raise FileExistsError(f"{target} exists") from None
        partial.rename(target)


def backup_before_upgrade(path: Path, connection: sqlite3.Connection) -> Path:
    """Copy a ledger of an earlier version to its own folder, as ``ledger.sqlite.v3-backup``; return the copy's path."""
    (version,) = connection.execute("SELECT value FROM meta WHERE key = 'schema_version'").fetchone()
    names = (f"{path.name}.v{version}-backup{f'-{number}' if number else ''}" for number in count())
    target = next(path.with_name(name) for name in names if not path.with_name(name).exists())
    copied(connection, target)
    return target
