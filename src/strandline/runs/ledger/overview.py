"""A quick overview of the runs in a ledger that does not read their interfaces; standard library only.

It works while a driver is at work, and takes no lock. Checksums are not compared: `Ledger.open` gives the interfaces.
"""

import contextlib
import json
import os
import socket
import sqlite3
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, cast

from strandline.runs.ledger import ledger_schema
from strandline.runs.ledger.ledger_schema import ATTEMPTS, INTERRUPTED, translated
from strandline.runs.ledger.plans import Exclusion, Plan, read_exclusions, read_plan

OPEN = "open"
"""State of a run that was started and has not ended: under way, or lost with its driver."""
WITH_SENSITIVITIES = """attempt IN
    (SELECT attempt FROM arrays INDEXED BY arrays_by_attempt WHERE role = 'sensitivity')"""
STATES = ("ok", "failed", "timeout", "killed", "invalid", OPEN)


class Attempt(NamedTuple):
    """One start of a run and how it ended; `seconds` and `finished_at` are None if it has not ended.

    The number is that among all starts of the ledger, the session that of the driver that started it. Inputs are JSON,
    times seconds since 1970. `state` is one of `STATES`, `kind` a short reason if it did not end ``ok``, `origin` the
    ledger that it was copied from; `sensitivities` tells whether it yielded them.
    """

    number: int
    session: int
    inputs: str
    started_at: float
    state: str
    kind: str | None = None
    seconds: float | None = None
    origin: str | None = None
    finished_at: float | None = None
    sensitivities: bool = False


class Run(NamedTuple):
    """A run with all its starts, in order, and the exclusion if somebody has excluded it by hand."""

    key: str
    attempts: tuple[Attempt, ...]
    exclusion: Exclusion | None = None

    @property
    def last(self) -> Attempt:
        return self.attempts[-1]

    @property
    def outcome(self) -> Attempt | None:
        return next((attempt for attempt in reversed(self.attempts) if attempt.state != OPEN), None)

    @property
    def inputs(self) -> Mapping[str, float]:
        return cast(dict[str, float], json.loads(self.last.inputs))

    def settled(self, *, sensitivities: bool) -> bool:
        """Return whether the run will not be tried again, given whether `sensitivities` are requested."""
        ended = self.outcome
        if ended is None:
            return False
        if self.exclusion is not None:
            return True
        lacking = sensitivities and ended.state == "ok" and not ended.sensitivities
        return (ended.state != "killed" and not lacking) or self._tries() >= ATTEMPTS

    def _tries(self) -> int:
        """Return how often it was tried since it last ended for good, without tries that the driver interrupted."""
        ends = [attempt.number for attempt in self.attempts if attempt.state not in ("killed", OPEN)]
        since = max(ends, default=0)
        return sum(attempt.number > since and attempt.kind != INTERRUPTED for attempt in self.attempts)


@dataclass(frozen=True)
class Details:
    """Details of one start."""

    message: str
    log: str
    diagnostics: Mapping[str, float]


@dataclass(frozen=True)
class Driver:
    """The process that last opened the ledger to make runs; `at_work` is None if it cannot be found out from here."""

    session: int
    pid: int
    host: str
    opened_at: float
    at_work: bool | None


Opened = TypeVar("Opened")


class OpenedLedger(contextlib.AbstractContextManager[Opened]):
    """The file of a ledger, opened, as a context manager: what `Overview` and `Ledger` share."""

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path, self._connection = path, connection

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        self._connection.close()

    def __exit__(self, *error: object) -> None:
        self.close()

    @property
    def model(self) -> str:
        """Fingerprint of the model whose runs these are."""
        return self._meta("model")

    def exclusions(self) -> Mapping[str, Exclusion]:
        """Return the runs excluded by hand, by key."""
        with translated(self.path):
            return read_exclusions(self._connection)

    def _checked(self, model: str | None) -> None:
        """Refuse a ledger of another version, or of another model if one is given."""
        with self._closed_on_error(), translated(self.path):
            ledger_schema.require_version(self.path, self._connection)
            if model is not None:
                ledger_schema.require_model(self.path, self._connection, model)

    @contextlib.contextmanager
    def _closed_on_error(self) -> Iterator[None]:
        try:
            yield
        except BaseException:
            self.close()
            raise

    def _meta(self, key: str) -> str:
        with translated(self.path):
            return ledger_schema.fact(self.path, self._connection, key)

    def _rows(self, sql: str, values: Sequence[Any] = ()) -> list[Any]:
        with translated(self.path):
            return self._connection.execute(sql, values).fetchall()


class Overview(OpenedLedger["Overview"]):
    """A ledger opened to look at its runs."""

    def __init__(self, path: Path, *, model: str | None = None) -> None:
        """Open the ledger at `path`; LedgerError if it is missing, damaged, or of another version or `model`."""
        super().__init__(path, ledger_schema.opened_for_reading(path))
        self._checked(model)

    def plan(self, study_sha256: str) -> Plan | None:
        """Return what the study with this digest asks for; None if no driver has recorded it."""
        with translated(self.path):
            return read_plan(self._connection, study_sha256)

    def runs(self) -> list[Run]:
        """Return all distinct runs, in the order of their last starts."""
        found: dict[str, list[Attempt]] = {}
        with translated(self.path):
            for key, attempt in self._attempts():
                found.setdefault(key, []).append(attempt)
            excluded = read_exclusions(self._connection)
        runs = [Run(key, tuple(attempts), excluded.get(key)) for key, attempts in found.items()]
        return sorted(runs, key=lambda run: run.last.number)

    def changes(self, after: int, among: Collection[int]) -> list[tuple[str, Attempt]]:
        """Return keys and starts numbered above `after`, and those `among` numbers, which had not ended before."""
        which = "attempt > ? OR attempt IN (SELECT value FROM json_each(?))"
        with translated(self.path):
            return list(self._attempts(which, (after, json.dumps([*among]))))

    def details(self, numbers: Iterable[int]) -> dict[int, Details]:
        """Return message, log and diagnostics of those starts that have ended."""
        sql = "SELECT message, log, diagnostics FROM outcomes WHERE attempt = ?"
        rows = [(number, *row) for number in numbers for row in self._rows(sql, (number,))]
        return {number: Details(message or "", log, json.loads(found)) for number, message, log, found in rows}

    def copy_to(self, target: Path) -> None:
        """Copy the ledger to a new file; errors are those of `copied`."""
        ledger_schema.copied(self._connection, target)

    def driver(self) -> Driver | None:
        """Return the process that last opened the ledger to make runs; None if there was none."""
        sql = "SELECT session, pid, host, opened_at FROM sessions ORDER BY session DESC LIMIT 1"
        if not (rows := self._rows(sql)):
            return None
        session, pid, host, opened_at = rows[0]
        return Driver(session, pid, host, opened_at, is_at_work(pid, host, self.path.with_suffix(".lock")))

    def _attempts(self, which: str = "1", given: Sequence[object] = ()) -> Iterator[tuple[str, Attempt]]:
        # Without the index, each row is read past its interface.
        sql = f"""SELECT key, attempt, session, inputs, started_at, COALESCE(state, '{OPEN}'), kind, seconds, origin,
            finished_at, {WITH_SENSITIVITIES}
            FROM starts LEFT JOIN outcomes INDEXED BY outcomes_told USING (attempt) WHERE {which} ORDER BY attempt"""
        for key, *told, with_slopes in self._connection.execute(sql, given):
            yield key, Attempt._make((*told, bool(with_slopes)))


def is_at_work(pid: int, host: str, lock: Path) -> bool | None:
    """Return whether the process `pid` on `host` holds the file `lock`, without touching it; None from another host.

    The lock is held as long as the file is open. If the system does not say who has it open, a process that is alive
    does.
    """
    if host != socket.gethostname() or os.name != "posix":
        return None
    if not exists(pid):
        return False
    try:
        held = lock.stat()
    except FileNotFoundError:
        return False
    try:
        descriptors = list(Path(f"/proc/{pid}/fd").iterdir())
    except OSError:
        return True
    for descriptor in descriptors:
        with contextlib.suppress(OSError):
            if os.path.samestat(descriptor.stat(), held):
                return True
    return False


def exists(pid: int) -> bool:
    """Return whether there is a process of this number, whoever owns it."""
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    return True
