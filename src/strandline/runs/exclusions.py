"""Runs excluded by hand, as stored in the ledger; standard library only."""

import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass

from strandline.errors import LedgerError
from strandline.runs.tables import has_table

__all__ = ["Exclusion", "read_exclusions", "require_reason", "write_exclusion"]


@dataclass(frozen=True)
class Exclusion:
    """Why a run is excluded, and since when.

    Args:
        why: Reason in words.
        decided_at: Seconds since 1970.
    """

    why: str
    decided_at: float


def read_exclusions(connection: sqlite3.Connection) -> Mapping[str, Exclusion]:
    """Return the runs that are excluded now, by key; none in a ledger of an earlier version."""
    if not has_table(connection, "exclusions"):
        return {}
    found: dict[str, Exclusion] = {}
    sql = "SELECT key, excluded, why, decided_at FROM exclusions ORDER BY exclusion"
    for key, excluded, why, decided_at in connection.execute(sql):
        if excluded:
            found[key] = Exclusion(why, decided_at)
        else:
            found.pop(key, None)
    return found


def require_reason(why: str) -> str:
    """Return the reason on one line.

    Raises:
        LedgerError: The reason is empty.
    """
    if not why.strip():
        raise LedgerError(
            "reason for excluding a run",
            value="an empty text",
            expected="a few words",
            remedy='Say why: --why "the mesh folded over".',
        )
    return " ".join(why.split())


def write_exclusion(
    connection: sqlite3.Connection, session: int, key: str, *, excluded: bool, why: str, at: float
) -> None:
    """Add a row that says whether a run is excluded from now on.

    Raises:
        LedgerError: The run has not ended yet, or is excluded (or not) already.
    """
    ended = "SELECT count(*) FROM starts JOIN outcomes USING (attempt) WHERE key = ?"
    known = read_exclusions(connection)
    if not connection.execute(ended, (key,)).fetchone()[0]:
        raise _refused(key, "no outcome yet", "a run that has ended")
    if excluded == (key in known):
        raise _refused(key, "excluded already" if excluded else "not excluded", "a run in the opposite state")
    sql = "INSERT INTO exclusions (session, key, excluded, why, decided_at) VALUES (?, ?, ?, ?, ?)"
    connection.execute(sql, (session, key, int(excluded), why, at))


def _refused(key: str, found: str, expected: str) -> LedgerError:
    return LedgerError(
        f"run {key[:12]}",
        value=found,
        expected=expected,
        remedy="`strandline runs STUDY` lists the runs with their states.",
    )
