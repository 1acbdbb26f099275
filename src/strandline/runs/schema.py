"""The ledger's file format: tables, versions, and the way a record becomes a row and back."""

import contextlib
import hashlib
import json
import os
import sqlite3
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped

from strandline.errors import LedgerError
from strandline.interface import Interface
from strandline.runs.record import RunRecord

__all__ = ["MARKS", "OUTCOME_COLUMNS", "VERSION", "connect", "connect_read_only", "create", "record_of", "row_of"]

VERSION = 1
APPEND_ONLY = ("sessions", "starts", "outcomes")
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
"""
OUTCOME_COLUMNS = (
    "state, points, points_shape, cells, cells_shape, diagnostics, seconds, kind, message, log, origin, checksum"
)
MARKS = ",".join("?" * (OUTCOME_COLUMNS.count(",") + 3))


def create(path: Path, *, model: str, description: str) -> None:
    """Write an empty ledger at `path`: it appears there complete or not at all."""
    draft = path.with_name(path.name + ".new")
    try:
        for stale in (draft, *(draft.with_name(draft.name + end) for end in ("-journal", "-wal", "-shm"))):
            stale.unlink(missing_ok=True)
        with contextlib.closing(sqlite3.connect(draft, isolation_level=None)) as connection:
            _fill(connection, model, description)
        draft.replace(path)
        _synchronise(path.parent)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise


def connect(path: Path) -> sqlite3.Connection:
    """Return a connection that writes durably: each statement is on the disk when it returns."""
    connection = sqlite3.connect(path, isolation_level=None, timeout=30.0)
    try:
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("PRAGMA foreign_keys = ON")
    except BaseException:
        connection.close()
        raise
    return connection


def connect_read_only(path: Path) -> sqlite3.Connection:
    """Return a connection that cannot write.

    Where no write-ahead log lies beside the file nobody is writing it, and it is taken as it is: SQLite would otherwise
    make a log's index that a reader cannot remove, or fail in a folder that cannot be written.
    """
    being_written = path.with_name(path.name + "-wal").exists()
    address = path.resolve().as_uri() + ("?mode=ro" if being_written else "?mode=ro&immutable=1")
    connection = sqlite3.connect(address, uri=True, isolation_level=None, timeout=30.0)
    try:
        connection.execute("SELECT count(*) FROM sqlite_schema")
    except BaseException:
        connection.close()
        raise
    return connection


def require_version(path: Path, connection: sqlite3.Connection) -> None:
    """Refuse a file of a newer version, or one that is no ledger."""
    row = connection.execute("SELECT value FROM meta WHERE key = 'schema_version'").fetchone()
    version = int(row[0]) if row and str(row[0]).isdigit() else None
    if version is None or version > VERSION:
        raise LedgerError(
            f"version of the ledger {path}",
            value=version,
            expected=f"at most {VERSION}",
            remedy="Install a newer strandline, or start a new ledger.",
        )


def inputs_text(inputs: Mapping[str, float]) -> str:
    """Return inputs as JSON; every float survives the way there and back."""
    return json.dumps({name: float(value) for name, value in inputs.items()})


def row_of(record: RunRecord, origin: str | None) -> tuple[Any, ...]:
    """Return the values of `OUTCOME_COLUMNS`, the checksum last."""
    given = record.interface
    points, cells = (None, None) if given is None else (given.points.astype("<f8"), given.cells.astype("<i8"))
    values = (
        record.state,
        *_packed(points),
        *_packed(cells),
        json.dumps(dict(record.diagnostics)),
        float(record.seconds),
        record.failure_kind,
        record.message,
        record.log,
        origin,
    )
    return *values, _checksum(record.key, inputs_text(record.inputs), values)


def record_of(path: Path, row: tuple[Any, ...]) -> RunRecord:
    """Return the record of a row (key, inputs, *`OUTCOME_COLUMNS`).

    Raises:
        LedgerError: the row does not match its checksum.
    """
    key, inputs, *values, checksum = row
    if checksum != _checksum(key, inputs, tuple(values)):
        raise LedgerError(
            f"run {key[:12]} in {path} is damaged",
            value=f"inputs {inputs}",
            expected=f"contents with the checksum {checksum[:12]}",
            remedy="Restore the ledger from a backup, or move it away and run again.",
        )
    state, points, points_shape, cells, cells_shape, diagnostics, seconds, kind, message, log, origin = values
    interface = None
    if points is not None:
        interface = Interface(_unpacked(points, points_shape, "<f8"), _unpacked(cells, cells_shape, "<i8"))
    figures = json.loads(diagnostics)
    return RunRecord(key, json.loads(inputs), state, interface, figures, seconds, kind, message, log, origin)


def _fill(connection: sqlite3.Connection, model: str, description: str) -> None:
    """Create tables and guards in one transaction and switch to the write-ahead log."""
    guards = "".join(
        f"CREATE TRIGGER {table}_no_{verb} BEFORE {verb} ON {table} "
        f"BEGIN SELECT RAISE(ABORT, 'the ledger is append-only'); END;\n"
        for table in APPEND_ONLY
        for verb in ("UPDATE", "DELETE")
    )
    connection.executescript(f"BEGIN;\n{TABLES}{guards}COMMIT;")
    facts = {"schema_version": VERSION, "model": model, "description": description, "created_at": time.time()}
    connection.executemany("INSERT INTO meta VALUES (?, ?)", [(key, str(value)) for key, value in facts.items()])
    connection.execute("PRAGMA journal_mode = WAL")


def _synchronise(folder: Path) -> None:
    """Put the folder's own entries on the disk, where the platform can."""
    if os.name == "posix":
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _packed(array: Shaped[np.ndarray, "..."] | None) -> tuple[bytes | None, str | None]:
    return (None, None) if array is None else (array.tobytes(), json.dumps(array.shape))


def _unpacked(data: bytes, shape: str, kind: str) -> Shaped[np.ndarray, "..."]:
    native = np.dtype(kind).newbyteorder("=")
    return np.frombuffer(data, dtype=kind).reshape(json.loads(shape)).astype(native)


def _checksum(key: str, inputs: str, values: tuple[Any, ...]) -> str:
    """Return sha256 over everything a row says, each value with its length so that none can flow into the next."""
    digest = hashlib.sha256()
    for value in (key, inputs, *values):
        part = value if isinstance(value, bytes) else repr(value).encode()
        digest.update(f"{len(part)}:".encode() + part)
    return digest.hexdigest()
