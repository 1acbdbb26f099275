"""The ledger's file format: tables, versions, and the way a record becomes a row and back."""

import contextlib
import hashlib
import json
import os
import sqlite3
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped

from strandline.errors import LedgerError
from strandline.interface import Interface
from strandline.runs.record import RunRecord

__all__ = [
    "ARRAY_COLUMNS",
    "ARRAY_MARKS",
    "MARKS",
    "OUTCOME_COLUMNS",
    "VERSION",
    "connect",
    "connect_read_only",
    "create",
    "has_arrays",
    "record_of",
    "rows_of",
    "upgrade",
]

VERSION = 2
"""1: one unnamed interface per outcome. 2: a table of further arrays: named conditions, sensitivities."""
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
ARRAYS = """
CREATE TABLE arrays (
    attempt INTEGER NOT NULL REFERENCES outcomes,
    role TEXT NOT NULL CHECK (role IN ('points', 'cells', 'sensitivity')),
    condition TEXT NOT NULL,
    input TEXT NOT NULL,
    shape TEXT NOT NULL,
    data BLOB NOT NULL
);
CREATE UNIQUE INDEX arrays_by_attempt ON arrays (attempt, role, condition, input);
"""
"""What version 2 adds; a run of one unnamed condition without sensitivities is stored as in version 1."""
OUTCOME_COLUMNS = (
    "state, points, points_shape, cells, cells_shape, diagnostics, seconds, kind, message, log, origin, checksum"
)
MARKS = ",".join("?" * (OUTCOME_COLUMNS.count(",") + 3))
ARRAY_COLUMNS = "role, condition, input, shape, data"
ARRAY_MARKS = ",".join("?" * (ARRAY_COLUMNS.count(",") + 2))


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


def rows_of(record: RunRecord, origin: str | None) -> tuple[tuple[Any, ...], list[tuple[Any, ...]]]:
    """Return the values of `OUTCOME_COLUMNS`, the checksum last, and the rows (`ARRAY_COLUMNS`) that go with them."""
    plain = record.interface if set(record.interfaces) == {""} else None
    points, cells = (None, None) if plain is None else (plain.points.astype("<f8"), plain.cells.astype("<i8"))
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
    arrays = list(_arrays(record))
    return (*values, _checksum(record.key, inputs_text(record.inputs), values, arrays)), arrays


def record_of(path: Path, row: tuple[Any, ...], arrays: Sequence[tuple[Any, ...]]) -> RunRecord:
    """Return the record of a row (key, inputs, *`OUTCOME_COLUMNS`) and its `arrays`, rows of `ARRAY_COLUMNS`.

    Raises:
        LedgerError: the rows do not match their checksum.
    """
    key, inputs, *values, checksum = row
    if checksum != _checksum(key, inputs, tuple(values), arrays):
        raise LedgerError(
            f"run {key[:12]} in {path} is damaged",
            value=f"inputs {inputs}",
            expected=f"contents with the checksum {checksum[:12]}",
            remedy="Restore the ledger from a backup, or move it away and run again.",
        )
    state, points, points_shape, cells, cells_shape, diagnostics, seconds, kind, message, log, origin = values
    plain = {} if points is None else {"": _interface(points, points_shape, cells, cells_shape)}
    figures = json.loads(diagnostics)
    record = RunRecord(key, json.loads(inputs), state, plain, figures, seconds, kind, message, log, origin)
    return _with_arrays(record, arrays) if arrays else record


def has_arrays(connection: sqlite3.Connection) -> bool:
    """Tell whether the ledger has the table of version 2; a writer may upgrade it while it is being read."""
    sql = "SELECT count(*) FROM sqlite_schema WHERE type = 'table' AND name = 'arrays'"
    return bool(connection.execute(sql).fetchone()[0])


def upgrade(connection: sqlite3.Connection) -> None:
    """Make a ledger of version 1 one of this version, in one transaction; no row that it holds is touched."""
    if has_arrays(connection):
        return
    try:
        connection.executescript(
            f"BEGIN IMMEDIATE;\n{ARRAYS}{_guards(['arrays'])}"
            f"UPDATE meta SET value = '{VERSION}' WHERE key = 'schema_version';\nCOMMIT;"
        )
    except BaseException:
        if connection.in_transaction:
            connection.execute("ROLLBACK")
        raise


def _arrays(record: RunRecord) -> Iterator[tuple[str, str, str, str, bytes]]:
    """Yield the rows of all that the columns of an outcome do not hold: named conditions, sensitivities."""
    if set(record.interfaces) != {""}:
        for condition, interface in record.interfaces.items():
            yield "points", condition, "", *_row(interface.points.astype("<f8"))
            yield "cells", condition, "", *_row(interface.cells.astype("<i8"))
    for condition, by_input in record.sensitivities.items():
        for name, derivative in by_input.items():
            yield "sensitivity", condition, name, *_row(derivative.astype("<f8"))


def _with_arrays(record: RunRecord, rows: Sequence[tuple[Any, ...]]) -> RunRecord:
    """Return `record` with its named conditions and sensitivities, in the order in which they were stored."""
    cells = {row[1]: row for row in rows if row[0] == "cells"}
    interfaces = dict(record.interfaces)
    sensitivities: dict[str, dict[str, Any]] = {}
    for role, condition, name, shape, data in rows:
        if role == "points":
            interfaces[condition] = _interface(data, shape, cells[condition][4], cells[condition][3])
        elif role == "sensitivity":
            sensitivities.setdefault(condition, {})[name] = _unpacked(data, shape, "<f8")
    return replace(record, interfaces=interfaces, sensitivities=sensitivities)


def _interface(points: bytes, points_shape: str, cells: bytes, cells_shape: str) -> Interface:
    return Interface(_unpacked(points, points_shape, "<f8"), _unpacked(cells, cells_shape, "<i8"))


def _guards(tables: Sequence[str]) -> str:
    """Return the triggers that keep rows of these tables as they are."""
    return "".join(
        f"CREATE TRIGGER {table}_no_{verb} BEFORE {verb} ON {table} "
        f"BEGIN SELECT RAISE(ABORT, 'the ledger is append-only'); END;\n"
        for table in tables
        for verb in ("UPDATE", "DELETE")
    )


def _fill(connection: sqlite3.Connection, model: str, description: str) -> None:
    """Create tables and guards in one transaction and switch to the write-ahead log."""
    tables = f"{TABLES}{ARRAYS}{_guards([*APPEND_ONLY, 'arrays'])}"
    connection.executescript(f"BEGIN;\n{tables}COMMIT;")
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


def _row(array: Shaped[np.ndarray, "..."]) -> tuple[str, bytes]:
    return json.dumps(array.shape), array.tobytes()


def _unpacked(data: bytes, shape: str, kind: str) -> Shaped[np.ndarray, "..."]:
    native = np.dtype(kind).newbyteorder("=")
    return np.frombuffer(data, dtype=kind).reshape(json.loads(shape)).astype(native)


def _checksum(key: str, inputs: str, values: tuple[Any, ...], arrays: Sequence[tuple[Any, ...]]) -> str:
    """Return sha256 over everything the rows say, each value with its length so that none can flow into the next."""
    digest = hashlib.sha256()
    for value in (key, inputs, *values, *(value for row in arrays for value in row)):
        part = value if isinstance(value, bytes) else repr(value).encode()
        digest.update(f"{len(part)}:".encode() + part)
    return digest.hexdigest()
