"""How a record becomes rows of the ledger and is rebuilt from them; the tables are in `ledger_schema`."""

import hashlib
import json
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Shaped

from strandline.foundations import LedgerError, require
from strandline.interface import Interface
from strandline.runs.ledger import ledger_schema
from strandline.runs.ledger.ledger_schema import translated
from strandline.runs.ledger.plans import read_exclusions
from strandline.runs.ledger.record import RunRecord

OUTCOME_COLUMNS = (
    "state, points, points_shape, cells, cells_shape, diagnostics, seconds, kind, message, log, origin, checksum"
)
MARKS = ",".join("?" * (OUTCOME_COLUMNS.count(",") + 3))
ARRAY_COLUMNS = "role, condition, input, shape, data"
ARRAY_MARKS = ",".join("?" * (ARRAY_COLUMNS.count(",") + 2))
MOST = 5
"""Maximum number of damaged runs to name."""


def inputs_text(inputs: Mapping[str, float]) -> str:
    """Return inputs as JSON; every float survives the round trip."""
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
    """Return the record of a row (key, inputs, *`OUTCOME_COLUMNS`) and its `arrays`; refuse another checksum."""
    key, inputs, *values, checksum = row
    sound, what = checksum == _checksum(key, inputs, tuple(values), arrays), f"run {key[:12]} in {path} is damaged"
    expected = f"contents with the checksum {checksum[:12]}"
    remedy = "Restore the ledger from a backup, or move it away and run again."
    require(sound, what, f"inputs {inputs}", expected, remedy, LedgerError)
    state, points, points_shape, cells, cells_shape, diagnostics, seconds, kind, message, log, origin = values
    plain = {} if points is None else {"": _interface(points, points_shape, cells, cells_shape)}
    figures = json.loads(diagnostics)
    record = RunRecord(key, json.loads(inputs), state, plain, figures, seconds, kind, message, log, origin)
    return _with_arrays(record, arrays) if arrays else record


def _arrays(record: RunRecord) -> Iterator[tuple[str, str, str, str, bytes]]:
    """Yield rows for what the columns of an outcome do not hold: named conditions, sensitivities."""
    if set(record.interfaces) != {""}:
        for condition, interface in record.interfaces.items():
            yield "points", condition, "", *_row(interface.points.astype("<f8"))
            yield "cells", condition, "", *_row(interface.cells.astype("<i8"))
    for condition, by_input in record.sensitivities.items():
        for name, derivative in by_input.items():
            yield "sensitivity", condition, name, *_row(derivative.astype("<f8"))
        if not by_input:
            yield "sensitivity", condition, "", *_row(np.empty(0))


def _with_arrays(record: RunRecord, rows: Sequence[tuple[Any, ...]]) -> RunRecord:
    """Return `record` with its named conditions and sensitivities, in the order in which they were stored."""
    cells = {row[1]: row for row in rows if row[0] == "cells"}
    interfaces = dict(record.interfaces)
    sensitivities: dict[str, dict[str, Any]] = {}
    for role, condition, name, shape, data in rows:
        if role == "points":
            interfaces[condition] = _interface(data, shape, cells[condition][4], cells[condition][3])
        elif role == "sensitivity":
            of_condition = sensitivities.setdefault(condition, {})
            if name:
                of_condition[name] = _unpacked(data, shape, "<f8")
    return replace(record, interfaces=interfaces, sensitivities=sensitivities)


def _interface(points: bytes, points_shape: str, cells: bytes, cells_shape: str) -> Interface:
    return Interface(_unpacked(points, points_shape, "<f8"), _unpacked(cells, cells_shape, "<i8"))


def _packed(array: Shaped[np.ndarray, "..."] | None) -> tuple[bytes | None, str | None]:
    return (None, None) if array is None else (array.tobytes(), json.dumps(array.shape))


def _row(array: Shaped[np.ndarray, "..."]) -> tuple[str, bytes]:
    return json.dumps(array.shape), array.tobytes()


def _unpacked(data: bytes, shape: str, kind: str) -> Shaped[np.ndarray, "..."]:
    native = np.dtype(kind).newbyteorder("=")
    return np.frombuffer(data, dtype=kind).reshape(json.loads(shape)).astype(native)


def _checksum(key: str, inputs: str, values: tuple[Any, ...], arrays: Sequence[tuple[Any, ...]]) -> str:
    """Return the sha256 of all values in the rows, each after its length so that none can run into the next."""
    digest = hashlib.sha256()
    for value in (key, inputs, *values, *(value for row in arrays for value in row)):
        part = value if isinstance(value, bytes) else repr(value).encode()
        digest.update(f"{len(part)}:".encode() + part)
    return digest.hexdigest()


def unsound(path: Path) -> Iterator[str]:
    """Yield a sentence for each thing wrong with the ledger at `path`; nothing if it is sound."""
    try:
        with closing(ledger_schema.opened_for_reading(path)) as connection, translated(path):
            ledger_schema.require_version(path, connection)
            checked = connection.execute(f"PRAGMA integrity_check({MOST})")
            yield from (f"SQLite says: {found}" for (found,) in checked if found != "ok")
            if astray := connection.execute("PRAGMA foreign_key_check").fetchone():
                yield f"a row of {astray[0]} refers to a row that does not exist"
            yield from _damaged_outcomes(path, connection)
    except LedgerError as error:
        yield " ".join(str(error).split())


def outcome_digest(path: Path, keys: frozenset[str]) -> str:
    """Return a digest of the last outcomes of these runs, and of which of them are excluded by hand."""
    sql = """SELECT key, checksum FROM outcomes JOIN starts USING (attempt)
        WHERE attempt IN (SELECT max(attempt) FROM outcomes JOIN starts USING (attempt) GROUP BY key) ORDER BY key"""
    with closing(ledger_schema.opened_for_reading(path)) as connection, translated(path):
        found = [row for row in connection.execute(sql) if row[0] in keys]
        excluded = sorted(keys & read_exclusions(connection).keys())
    return hashlib.sha256(repr((found, excluded)).encode()).hexdigest()


def _damaged_outcomes(path: Path, connection: sqlite3.Connection) -> Iterator[str]:
    """Yield the runs whose contents do not match their checksum."""
    damaged = []
    sql = f"SELECT attempt, key, inputs, {OUTCOME_COLUMNS} FROM outcomes JOIN starts USING (attempt)"
    of_one = f"SELECT {ARRAY_COLUMNS} FROM arrays WHERE attempt = ? ORDER BY rowid"
    for number, *row in connection.execute(sql):
        arrays = connection.execute(of_one, (number,)).fetchall()
        try:
            record_of(path, tuple(row), arrays)
        except (LedgerError, ValueError, KeyError, TypeError):
            damaged.append(f"run {str(row[0])[:12]} (start {number})")
    if damaged:
        more = f" and {len(damaged) - MOST} more" if len(damaged) > MOST else ""
        yield f"{len(damaged)} outcome(s) do not match their checksum: {', '.join(damaged[:MOST])}{more}"
