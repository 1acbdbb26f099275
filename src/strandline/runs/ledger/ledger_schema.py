"""The ledger's file: its tables, and how it is created, opened and copied; standard library only."""

import contextlib
import os
import sqlite3
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from strandline.foundations import LedgerError
from strandline.runs.ledger import journal

VERSION = 4
"""Of strandline 0.2 and later."""
EXCLUDED: Final = "excluded"
"""State of a run excluded by hand, whatever its outcome."""
INTERRUPTED = "interrupted"
"""Failure kind of a run that its driver stopped, after Ctrl-C or because of another run; it is not an attempt."""
LOG_TITLE = "last lines of its log:"
"""Line of a message that introduces the end of the run's log."""
ATTEMPTS = 3
"""Starts after which a campaign gives up on a run whose process vanishes each time."""
APPEND_ONLY = ("sessions", "starts", "outcomes", "arrays", "plans", "exclusions")
TABLES = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE sessions (
    session INTEGER PRIMARY KEY,
    pid INTEGER NOT NULL,
    host TEXT NOT NULL,
    opened_at REAL NOT NULL
);
CREATE TABLE starts (
    attempt INTEGER PRIMARY KEY,
    session INTEGER NOT NULL REFERENCES sessions,
    key TEXT NOT NULL,
    inputs TEXT NOT NULL,
    started_at REAL NOT NULL
);
CREATE INDEX starts_by_key ON starts (key);
CREATE TABLE outcomes (
    attempt INTEGER PRIMARY KEY REFERENCES starts,
    state TEXT NOT NULL,
    points BLOB, points_shape TEXT,
    cells BLOB, cells_shape TEXT,
    diagnostics TEXT NOT NULL,
    seconds REAL NOT NULL,
    kind TEXT, message TEXT, log TEXT NOT NULL, origin TEXT,
    checksum TEXT NOT NULL,
    finished_at REAL NOT NULL
);
CREATE TABLE arrays (
    attempt INTEGER NOT NULL REFERENCES outcomes,
    role TEXT NOT NULL CHECK (role IN ('points', 'cells', 'sensitivity')),
    condition TEXT NOT NULL,
    input TEXT NOT NULL,
    shape TEXT NOT NULL,
    data BLOB NOT NULL
);
CREATE UNIQUE INDEX arrays_by_attempt ON arrays (attempt, role, condition, input);
CREATE TABLE plans (
    plan INTEGER PRIMARY KEY,
    session INTEGER NOT NULL REFERENCES sessions,
    study_sha256 TEXT NOT NULL,
    part INTEGER NOT NULL,
    name TEXT NOT NULL,
    model TEXT NOT NULL,
    inputs TEXT NOT NULL,
    sensitivities INTEGER NOT NULL,
    planned INTEGER NOT NULL,
    keys TEXT NOT NULL,
    planned_at REAL NOT NULL
);
CREATE INDEX plans_by_study ON plans (study_sha256);
CREATE INDEX outcomes_told ON outcomes (attempt, state, kind, seconds, origin, finished_at);
CREATE TABLE exclusions (
    exclusion INTEGER PRIMARY KEY,
    session INTEGER NOT NULL REFERENCES sessions,
    key TEXT NOT NULL,
    excluded INTEGER NOT NULL CHECK (excluded IN (0, 1)),
    why TEXT NOT NULL,
    decided_at REAL NOT NULL
);
"""
"""A run of one unnamed condition without sensitivities has no row in `arrays`. The index `outcomes_told` shows how runs
ended without reading interfaces. The last row of a key in `exclusions` says whether that run is excluded by hand."""


GUARDS = "".join(
    f"CREATE TRIGGER {table}_no_{verb} BEFORE {verb} ON {table} "
    f"BEGIN SELECT RAISE(ABORT, 'the ledger is append-only'); END;\n"
    for table in APPEND_ONLY
    for verb in ("UPDATE", "DELETE")
)
"""Triggers that prevent changes to rows."""


def create(path: Path, *, model: str, description: str) -> None:
    """Create an empty ledger at `path`, completely or not at all."""
    draft = path.with_name(path.name + ".new")
    try:
        for stale in (draft, *(draft.with_name(draft.name + end) for end in ("-journal", "-wal", "-shm"))):
            stale.unlink(missing_ok=True)
        with contextlib.closing(sqlite3.connect(draft, isolation_level=None)) as connection:
            connection.executescript(f"BEGIN;\n{TABLES}{GUARDS}COMMIT;")
            facts = {"schema_version": VERSION, "model": model, "description": description, "created_at": time.time()}
            connection.executemany("INSERT INTO meta VALUES (?, ?)", [(key, str(one)) for key, one in facts.items()])
            journal.settle(connection, path)
        draft.replace(path)
        synchronise(path.parent)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise


def connect(path: Path) -> sqlite3.Connection:
    """Return a connection that writes durably: each statement is on the disk when it returns."""
    connection = sqlite3.connect(path, isolation_level=None, timeout=30.0)
    try:
        journal.settle(connection, path)
        connection.execute("PRAGMA foreign_keys = ON")
    except BaseException:
        connection.close()
        raise
    return connection


def connect_read_only(path: Path) -> sqlite3.Connection:
    """Return a connection that cannot write.

    If a ledger uses a write-ahead log and the log is missing, nobody is writing to the ledger, and it is read as it is:
    SQLite would otherwise create an index of the log that a reader cannot remove, or fail in a folder that is not
    writable. With a rollback journal, readers and the driver wait for each other. If a driver was killed while writing,
    the reader rolls back the unfinished write, as SQLite prescribes; this needs write permission.
    """
    may_be_written = path.with_name(path.name + "-wal").exists() or journal.has_rollback_journal(path)
    try:
        return _looked_at(path, "?mode=ro" if may_be_written else "?mode=ro&immutable=1")
    except sqlite3.OperationalError:
        if not path.with_name(path.name + "-journal").exists():
            raise
        return _looked_at(path, "?mode=rw")


def _looked_at(path: Path, options: str) -> sqlite3.Connection:
    """Return a connection that has read the ledger and cannot write to it."""
    connection = sqlite3.connect(path.resolve().as_uri() + options, uri=True, isolation_level=None, timeout=30.0)
    try:
        connection.execute("PRAGMA query_only = ON")
        connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()
    except BaseException:
        connection.close()
        raise
    return connection


def opened_for_reading(path: Path) -> sqlite3.Connection:
    """Return a connection that cannot write to the ledger at `path`.

    Raises:
        LedgerError: there is no such file, or it cannot be read.
    """
    if not path.is_file():
        raise LedgerError(
            f"ledger {path}",
            value="no such file",
            expected="a ledger",
            remedy="Run the study first, or correct the path.",
        )
    with translated(path):
        return connect_read_only(path)


def last_driver(path: Path) -> str:
    """Return process id and host of the driver that opened the ledger last."""
    try:
        with contextlib.closing(opened_for_reading(path)) as connection:
            row = connection.execute("SELECT pid, host FROM sessions ORDER BY session DESC LIMIT 1").fetchone()
    except (LedgerError, sqlite3.Error):
        row = None
    return f"process {row[0]} on {row[1]}" if row else "process unknown"


def require_sound(path: Path, connection: sqlite3.Connection) -> None:
    """Refuse a damaged file: SQLite silently skips rows that it can no longer find.

    Each run's contents have a checksum, but that does not help if the run is not found.
    """
    (found,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    if found != "ok":
        raise _damaged(path, " ".join(str(found).replace("***", "").split()))


def require_version(path: Path, connection: sqlite3.Connection) -> None:
    """Refuse a file of another version, or one that is not a ledger."""
    found = fact(path, connection, "schema_version")
    if found != str(VERSION):
        old = found in map(str, range(VERSION))
        way = f"`python -m verification.upgrade_ledger {path}`, in strandline's source, upgrades it"
        raise LedgerError(
            f"version of the ledger {path}",
            value=found,
            expected=str(VERSION),
            remedy=f"{way if old else 'Install a newer strandline'}; or start a new ledger.",
        )


def require_model(path: Path, connection: sqlite3.Connection, model: str) -> None:
    """Refuse a ledger that keeps runs of another model that ended ok, or have not ended."""
    kept = fact(path, connection, "model")
    kept_runs = "SELECT 1 FROM starts LEFT JOIN outcomes USING (attempt) WHERE ifnull(state, 'ok') = 'ok'"
    if model != kept and connection.execute(kept_runs).fetchone():
        raise another_model(path, kept, model)


def another_model(path: Path, kept: str, model: str) -> LedgerError:
    """Return the error about a ledger of the model `kept` that is opened for `model`."""
    own = " (of a function as it was under strandline 0.1: give it the ledger's text as its attribute `fingerprint`)"
    return LedgerError(
        f"{path} keeps the runs of another model",
        value=f"{kept} in the ledger, {model} now",
        expected="one and the same model",
        remedy=f"Undo the change of the model{own if kept.startswith('python:') else ''}, or move {path.name} away and "
        "run the study again; if the study names it in `reuse`, remove it there. A further condition makes another "
        "model: each run returns all conditions.",
    )


def adopt(connection: sqlite3.Connection, model: str) -> None:
    """Make `model` the one whose runs the ledger keeps; see `require_model`."""
    connection.execute("UPDATE meta SET value = ?1 WHERE key = 'model' AND value <> ?1", (model,))


def fact(path: Path, connection: sqlite3.Connection, key: str) -> str:
    """Return a row of the table `meta`; a ledger without it is damaged."""
    row = connection.execute("SELECT value FROM meta WHERE key = ?", (key,)).fetchone()
    if row is None:
        raise _damaged(path, f"no row {key} in its table meta")
    return str(row[0])


@contextlib.contextmanager
def translated(path: Path) -> Iterator[None]:
    """Turn errors of SQLite and of the file system into a `LedgerError` that names the file and the remedy."""
    try:
        yield
    except (sqlite3.OperationalError, OSError) as error:
        if "decode" in str(error):  # a text that is no longer valid
            raise _damaged(path, str(error)) from error
        raise LedgerError(
            f"ledger {path} cannot be read or written",
            value=str(error),
            expected="a readable file in a folder that can be written, with room on the disk",
            remedy="Correct permissions or disk space and run again: finished runs are kept.",
        ) from error
    except sqlite3.IntegrityError as error:
        raise LedgerError(
            f"ledger {path} does not take this row",
            value=str(error),
            expected="rows that are added once and never changed, by one driver at a time",
            remedy="Make sure that no other program writes to it, and run again: finished runs are kept.",
        ) from error
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        raise _damaged(path, str(error)) from error


def _damaged(path: Path, how: str) -> LedgerError:
    return LedgerError(
        f"ledger {path} is damaged or not a ledger",
        value=how,
        expected="a SQLite file written by strandline",
        remedy="Restore it from a backup, or move it away and run again.",
    )


def synchronise(folder: Path) -> None:
    """Put the folder's own entries on the disk, if the platform can."""
    if os.name == "posix":
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


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
        target.touch(exist_ok=False)
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)
