"""Checks whether a ledger is sound: SQLite's own check, and the checksum of every outcome, including earlier ones."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from hashlib import sha256
from pathlib import Path

from strandline.errors import LedgerError
from strandline.runs import rows, tables
from strandline.runs.exclusions import read_exclusions
from strandline.runs.tables import translated

__all__ = ["outcome_digest", "unsound"]

MOST = 5
"""Maximum number of damaged runs to name."""


def unsound(path: Path) -> Iterator[str]:
    """Yield a sentence for each thing wrong with the ledger at `path`; nothing if it is sound."""
    try:
        with closing(tables.opened_for_reading(path)) as connection, translated(path):
            tables.require_version(path, connection)
            checked = connection.execute(f"PRAGMA integrity_check({MOST})")
            yield from (f"SQLite says: {found}" for (found,) in checked if found != "ok")
            for table, *_ in connection.execute("PRAGMA foreign_key_check"):
                yield f"a row of {table} refers to a row that does not exist"
                break
            yield from _damaged_outcomes(path, connection)
    except LedgerError as error:
        yield " ".join(str(error).split())


def outcome_digest(path: Path, keys: frozenset[str]) -> str:
    """Return a digest of the last outcomes of these runs, and of which of them are excluded by hand."""
    sql = """SELECT key, checksum FROM outcomes JOIN starts USING (attempt)
        WHERE attempt IN (SELECT max(attempt) FROM outcomes JOIN starts USING (attempt) GROUP BY key) ORDER BY key"""
    with closing(tables.opened_for_reading(path)) as connection, translated(path):
        found = [row for row in connection.execute(sql) if row[0] in keys]
        excluded = sorted(keys & read_exclusions(connection).keys())
    return sha256(repr((found, excluded)).encode()).hexdigest()


def _damaged_outcomes(path: Path, connection: sqlite3.Connection) -> Iterator[str]:
    """Yield the runs whose contents do not match their checksum."""
    extended, damaged = tables.has_table(connection, "arrays"), []
    sql = f"SELECT attempt, key, inputs, {rows.OUTCOME_COLUMNS} FROM outcomes JOIN starts USING (attempt)"
    of_one = f"SELECT {rows.ARRAY_COLUMNS} FROM arrays WHERE attempt = ? ORDER BY rowid"
    for number, *row in connection.execute(sql):
        arrays = connection.execute(of_one, (number,)).fetchall() if extended else []
        try:
            rows.record_of(path, tuple(row), arrays)
        except (LedgerError, ValueError, KeyError, TypeError):
            damaged.append(f"run {str(row[0])[:12]} (start {number})")
    if damaged:
        more = f" and {len(damaged) - MOST} more" if len(damaged) > MOST else ""
        yield f"{len(damaged)} outcome(s) do not match their checksum: {', '.join(damaged[:MOST])}{more}"
