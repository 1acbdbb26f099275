"""The ledger: an append-only SQLite file that keeps every run of one model, durably, as it ends.

A run is STARTED before it is handed out and gets an outcome when it ends. A run that is STARTED without an outcome is
running while a driver holds the ledger, and lost otherwise. Only the driving process writes, under a lock, and each
write is on the disk when the call returns (full synchronisation; see `journal`). Arrays are stored as raw little-endian
numbers, and each outcome has a checksum; nothing is pickled. The file must be on a disk of the driving machine or on a
file system with working locks.
"""

import contextlib
import os
import socket
import sqlite3
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import BaseFileLock

from strandline.foundations import LedgerError
from strandline.models import ForwardModel, fingerprint
from strandline.runs.ledger import ledger_rows, ledger_schema, plans
from strandline.runs.ledger.ledger_schema import INTERRUPTED, translated
from strandline.runs.ledger.lock_watch import Hold, locked
from strandline.runs.ledger.overview import OpenedLedger
from strandline.runs.ledger.record import RunRecord, RunRequest, excluded

COPIED_STATES = frozenset({"ok", "failed", "invalid"})
"""Outcomes that the model decided; a timeout or a vanished process only says something about the other machine."""
KEYS_PER_QUERY = 500
RECORDS_PER_READING = 100
LAST_OUTCOMES = "SELECT max(attempt) FROM outcomes JOIN starts USING (attempt)"


@dataclass(frozen=True)
class Counts:
    """Distinct runs of a ledger by the outcome of their last start.

    `open` counts runs started without an outcome: running while a driver holds the ledger, lost otherwise.
    """

    ok: int = 0
    failed: int = 0
    timeout: int = 0
    killed: int = 0
    invalid: int = 0
    open: int = 0

    @property
    def total(self) -> int:
        """Number of distinct runs ever started."""
        return self.ok + self.failed + self.timeout + self.killed + self.invalid + self.open


class Ledger(OpenedLedger["Ledger"]):
    """All runs of one model; open it with `Ledger.open`, as a context manager."""

    def __init__(self, path: Path, connection: sqlite3.Connection, hold: Hold | None) -> None:
        super().__init__(path, connection)
        self._hold = hold
        self._session: int | None = None

    @classmethod
    def open(
        cls, path: Path | str, *, model: ForwardModel | str | None, description: str = "", read_only: bool = False
    ) -> "Ledger":
        """Return the ledger at `path`, a SQLite file with its lock beside it; create it if it does not exist yet.

        It keeps the runs of one model, given as such or by its fingerprint; `description` is a line about it, kept when
        the ledger is created. If no run of another model ended ok or is open, the ledger becomes that of this one. With
        `read_only`, no lock is taken and nothing written, which works while a driver is writing; None then accepts any
        model.

        Raises:
            LedgerError: the ledger is locked, of another model, of another version, damaged, missing (read-only), or in
                a folder that is not writable.
        """
        path = Path(path)
        identity = model if model is None or isinstance(model, str) else fingerprint(model)
        if read_only:
            ledger = cls(path, ledger_schema.opened_for_reading(path), None)
            ledger._checked(identity)
            return ledger
        if identity is None:
            raise LedgerError(
                f"model of the ledger {path}",
                value=None,
                expected="the model, or its fingerprint",
                remedy="Give it, or open the ledger with read_only=True.",
            )
        lock = locked(path)
        try:
            return cls._for_writing(path, identity, description, lock)
        except BaseException:
            lock.release()
            raise

    @classmethod
    def _for_writing(cls, path: Path, model: str, description: str, lock: BaseFileLock) -> "Ledger":
        with translated(path):
            if not path.exists():
                ledger_schema.create(path, model=model, description=description)
            connection = ledger_schema.connect(path)
        ledger = cls(path, connection, Hold(path, lock))
        ledger._checked(model)
        with ledger._closed_on_error(), translated(path):
            ledger_schema.require_sound(path, connection)
            ledger_schema.adopt(connection, model)
            columns = "(pid, host, opened_at) VALUES (?, ?, ?)"
            row = connection.execute(
                f"INSERT INTO sessions {columns}", (os.getpid(), socket.gethostname(), time.time())
            )
            ledger._session = row.lastrowid
        return ledger

    def close(self) -> None:
        """Close the file and release the lock; a second call does nothing."""
        super().close()
        if self._hold is not None:
            self._hold.release()

    @property
    def description(self) -> str:
        """The line about the model that was given when the ledger was created."""
        return self._meta("description")

    def started(self, request: RunRequest) -> int:
        """Record that a run is being started; return the number of the attempt."""
        return self._start(request, time.time())

    def finished(self, record: RunRecord) -> None:
        """Record the outcome of the run's last start that has none yet.

        Raises:
            LedgerError: the run was not started, or already has its outcome; see also `Hold.require`.
        """
        self._writing_session()
        sql = "SELECT max(attempt) FROM starts WHERE key = ? AND attempt NOT IN (SELECT attempt FROM outcomes)"
        (number,) = self._rows(sql, (record.key,))[0]
        if number is None:
            raise LedgerError(
                f"outcome of run {record.key[:12]}",
                value=record.state,
                expected="a run that was started and has no outcome yet",
                remedy="Call started() first, once per attempt.",
            )
        self._finish(number, record)

    def latest(self, keys: Iterable[str]) -> dict[str, RunRecord]:
        """Return the last outcome of each run in `keys` that has one; an excluded run counts as excluded instead.

        Raises:
            LedgerError: a stored outcome does not match its checksum.
        """
        wanted = list(dict.fromkeys(keys))
        found: dict[str, RunRecord] = {}
        for first in range(0, len(wanted), KEYS_PER_QUERY):
            some = wanted[first : first + KEYS_PER_QUERY]
            marks = ",".join("?" * len(some))
            last = f"SELECT max(attempt) FROM outcomes JOIN starts USING (attempt) WHERE key IN ({marks}) GROUP BY key"
            found |= {record.key: record for record in self._records(last, some)}
        left_out = self.exclusions()
        return {key: excluded(one, left_out[key].why) if key in left_out else one for key, one in found.items()}

    def __iter__(self) -> Iterator[RunRecord]:
        """Yield the last outcome of every run, in starting order; an excluded run counts as excluded instead."""
        left_out = self.exclusions()
        for record in self._records(f"{LAST_OUTCOMES} GROUP BY key"):
            yield excluded(record, left_out[record.key].why) if record.key in left_out else record

    def exclude(self, key: str, why: str) -> None:
        """Stop using this run, and do not make it again; its outcome is kept.

        Raises:
            LedgerError: no reason is given, or the run has no outcome or is excluded already.
        """
        self._decide(key, why, exclude=True)

    def include(self, key: str, why: str = "") -> None:
        """Use an excluded run again.

        Raises:
            LedgerError: the run is not excluded.
        """
        self._decide(key, why or "included again", exclude=False)

    def _decide(self, key: str, why: str, *, exclude: bool) -> None:
        session, reason = self._writing_session(), plans.require_reason(why)
        with translated(self.path):
            plans.write_exclusion(self._connection, session, key, excluded=exclude, why=reason, at=time.time())

    def attempts(self, key: str) -> int:
        """Return how often the run was tried; starts that the driver itself interrupted do not count."""
        sql = "SELECT count(*) FROM starts LEFT JOIN outcomes USING (attempt) WHERE key = ? AND kind IS NOT ?"
        return int(self._rows(sql, (key, INTERRUPTED))[0][0])

    def open_attempts(self, key: str) -> int:
        """Return how often the run was tried since it last ended for good; see `attempts`."""
        sql = """SELECT count(*) FROM starts LEFT JOIN outcomes USING (attempt) WHERE key = ?1 AND kind IS NOT ?2
            AND attempt > (SELECT ifnull(max(attempt), 0) FROM starts JOIN outcomes USING (attempt)
                WHERE key = ?1 AND state <> 'killed')"""
        return int(self._rows(sql, (key, INTERRUPTED))[0][0])

    def open_runs(self, keys: Iterable[str]) -> frozenset[str]:
        """Return the runs in `keys` whose last start has no outcome."""
        sql = """SELECT key FROM starts LEFT JOIN outcomes USING (attempt)
            WHERE state IS NULL AND attempt IN (SELECT max(attempt) FROM starts GROUP BY key)"""
        return frozenset(keys) & {row[0] for row in self._rows(sql)}

    def counts(self) -> Counts:
        """Return the number of distinct runs by the outcome of their last start."""
        sql = """SELECT ifnull(state, 'open'), count(*) FROM starts LEFT JOIN outcomes USING (attempt)
            WHERE attempt IN (SELECT max(attempt) FROM starts GROUP BY key) GROUP BY 1"""
        return Counts(**dict(self._rows(sql)))

    def copy_from(self, other: Path | str, keys: Iterable[str], *, sensitivities: bool = False) -> int:
        """Copy the runs in `keys` that are missing here from another ledger of the same model.

        Only outcomes that the model decided (ok, failed, invalid) are copied; `origin` says where they came from. If
        `sensitivities` are requested, a successful run without them counts as missing in both ledgers.

        Returns:
            The number of runs copied.

        Raises:
            LedgerError: the other ledger is missing, unreadable, or of another model.
        """
        self._writing_session()
        wanted = list(keys)
        known = self.latest(wanted).items()
        here = {key for key, record in known if record.settles(sensitivities=sensitivities)}
        with Ledger.open(other, model=self.model, read_only=True) as source:
            found = source.latest(key for key in wanted if key not in here).values()
        taken = [r for r in found if r.state in COPIED_STATES and r.settles(sensitivities=sensitivities)]
        with self._transaction():
            for record in taken:
                number = self._start(RunRequest(record.key, record.inputs), time.time())
                self._finish(number, record, origin=record.origin or str(other))
        return len(taken)

    def plan(self, plan: plans.Plan) -> None:
        """Record which runs a study asks for; write nothing if that is known already.

        Rounds of refinement that depend on runs not made yet are added by a later call.
        """
        session = self._writing_session()
        with translated(self.path):
            new = plans.rows_to_write(plan, plans.read_plan(self._connection, plan.study_sha256))
        if new:
            with self._transaction(), translated(self.path):
                sql = f"INSERT INTO plans (session, planned_at, {plans.COLUMNS}) VALUES (?, ?{', ?' * len(new[0])})"
                self._connection.executemany(sql, [(session, time.time(), *row) for row in new])

    def _start(self, request: RunRequest, at: float) -> int:
        row = (self._writing_session(), request.key, ledger_rows.inputs_text(request.inputs), at)
        with translated(self.path):
            sql = "INSERT INTO starts (session, key, inputs, started_at) VALUES (?, ?, ?, ?)"
            return int(self._connection.execute(sql, row).lastrowid or 0)

    def _finish(self, number: int, record: RunRecord, *, origin: str | None = None) -> None:
        self._writing_session()
        outcome, arrays = ledger_rows.rows_of(record, origin or record.origin)
        row = (number, *outcome, time.time())
        alone = not arrays or self._connection.in_transaction
        with contextlib.nullcontext() if alone else self._transaction(), translated(self.path):
            columns = f"attempt, {ledger_rows.OUTCOME_COLUMNS}, finished_at"
            sql = f"INSERT INTO outcomes ({columns}) VALUES ({ledger_rows.MARKS})"
            self._connection.execute(sql, row)
            sql = f"INSERT INTO arrays (attempt, {ledger_rows.ARRAY_COLUMNS}) VALUES ({ledger_rows.ARRAY_MARKS})"
            self._connection.executemany(sql, [(number, *array) for array in arrays])

    def _writing_session(self) -> int:
        if self._session is None:
            raise LedgerError(
                f"writing to {self.path}",
                value="a ledger opened with read_only=True",
                expected="a ledger opened for writing",
                remedy="Open it without read_only.",
            )
        if self._hold is not None:
            with translated(self.path):
                self._hold.require(self._connection, self._session)
        return self._session

    @contextlib.contextmanager
    def _transaction(self) -> Iterator[None]:
        """Combine all writes inside into one transaction: either all of them last, or none."""
        with translated(self.path):
            self._connection.execute("BEGIN IMMEDIATE")
        try:
            yield
        except BaseException:
            self._connection.execute("ROLLBACK")
            raise
        with translated(self.path):
            self._connection.execute("COMMIT")

    def _records(self, attempts: str, values: Sequence[Any] = ()) -> Iterator[RunRecord]:
        numbers = self._rows(f"SELECT attempt FROM outcomes WHERE attempt IN ({attempts}) ORDER BY attempt", values)
        columns = f"key, inputs, {ledger_rows.OUTCOME_COLUMNS}"
        sql = f"SELECT {columns} FROM outcomes JOIN starts USING (attempt) WHERE attempt = ?"
        for first in range(0, len(numbers), RECORDS_PER_READING):
            with self._reading():  # ends before the caller goes on: a driver cannot write meanwhile
                records = [
                    ledger_rows.record_of(self.path, self._rows(sql, number)[0], self._arrays(*number))
                    for number in numbers[first : first + RECORDS_PER_READING]
                ]
            yield from records

    @contextlib.contextmanager
    def _reading(self) -> Iterator[None]:
        """Take a reader's lock once for everything that is read inside."""
        with translated(self.path):
            alone = not self._connection.in_transaction
            if alone:
                self._connection.execute("BEGIN")
            try:
                yield
            finally:
                if alone:
                    self._connection.execute("COMMIT")

    def _arrays(self, number: int) -> list[Any]:
        sql = f"SELECT {ledger_rows.ARRAY_COLUMNS} FROM arrays WHERE attempt = ? ORDER BY rowid"
        return self._connection.execute(sql, (number,)).fetchall()
