"""A ledger looked at without its interfaces: the same as the records say, and who is at work."""

import os
import socket
import sqlite3
from contextlib import closing

import numpy as np
import pytest
from tests.unit.runs.ledgers import BAD, put

from strandline.errors import LedgerError
from strandline.interface import Interface
from strandline.runs import Ledger, RunRecord, RunRequest, tables
from strandline.runs.overview import OPEN, STATES, Overview, is_at_work
from strandline.runs.record import STATES as ENDS
from strandline.studies.study_runs import settled

LINE = Interface.polyline(np.arange(8.0).reshape(4, 2))
SLOPES = {"": {"E": np.ones((4, 2))}}
KEYS = [f"k{number}" for number in range(40)]


def some_end(key, rng):
    state, interrupted = str(rng.choice(ENDS)), rng.random() < 0.3
    kind = None if state == "ok" else "interrupted" if state == "killed" and interrupted else f"because_{state}"
    slopes = SLOPES if state == "ok" and rng.random() < 0.5 else {}
    good = {"": LINE} if state == "ok" else {}
    return RunRecord(key, {"E": 1.0}, state, good, seconds=float(rng.random()), failure_kind=kind, sensitivities=slopes)


def at_random(ledger, rng):
    """Start runs and let most of them end, several times some."""
    with ledger._transaction():
        for key in rng.choice(KEYS, 150).tolist():
            ledger.started(RunRequest(key, {"E": 1.0}))
            if rng.random() < 0.8:
                ledger.finished(some_end(key, rng))


@pytest.mark.parametrize("seed", range(3))
def test_settled_runs_are_those_of_the_records(path, seed):
    with Ledger.open(path, model="m") as ledger:
        at_random(ledger, np.random.default_rng(seed))
        with Overview(path) as overview:
            runs = overview.runs()
        for sensitivities in (False, True):
            expected = {record.key: record for record in settled(ledger, KEYS, sensitivities=sensitivities)}
            found = {run.key: run.outcome for run in runs if run.settled(sensitivities=sensitivities)}
            assert set(found) == set(expected)
            assert 0 < len(found) < len(runs)
            for key, record in expected.items():
                end = found[key]
                assert (end.state, end.kind, end.seconds) == (record.state, record.failure_kind, record.seconds)
                assert end.sensitivities == bool(record.sensitivities)
        for state in STATES:
            assert sum(run.last.state == state for run in runs) == getattr(ledger.counts(), state)
    assert [run.last.number for run in runs] == sorted(run.last.number for run in runs)
    assert (*ENDS, OPEN) == STATES


def test_details_are_those_of_the_record_and_changes_are_told(path):
    with Ledger.open(path, model="m") as ledger:
        put(ledger, BAD)
        number = ledger.started(RunRequest("open", {"E": 3.0}))
        with Overview(path, model="m") as overview:
            assert [(run.key, run.inputs) for run in overview.runs()] == [("bad", {"E": 2.0}), ("open", {"E": 3.0})]
            details = overview.details([number - 1, number])
            assert overview.changes(number, []) == []
            ledger.finished(RunRecord("open", {"E": 3.0}, "timeout"))
            ledger.started(RunRequest("next", {"E": 4.0}))
            changes = [(key, attempt.state) for key, attempt in overview.changes(number, [number])]
            assert changes == [("next", "open"), ("open", "timeout")]
    (told,) = details.values()
    assert (told.message, told.log, told.diagnostics) == (BAD.message, BAD.log, BAD.diagnostics)
    with pytest.raises(LedgerError, match="another model"):
        Overview(path, model="other")


def test_interfaces_are_not_passed_over(path):
    """Asked of SQLite itself: outcomes are taken from the index alone, which holds no interface."""
    Ledger.open(path, model="m").close()
    asked = []
    with Overview(path) as overview:
        overview._connection.set_trace_callback(asked.append)
        overview.runs()
    (sql,) = [text for text in asked if "outcomes" in text]
    with closing(sqlite3.connect(path)) as connection:
        plan = [row[3] for row in connection.execute(f"EXPLAIN QUERY PLAN {sql}")]
    assert any("outcomes USING COVERING INDEX outcomes_told" in line for line in plan)


def test_whether_a_driver_is_at_work_is_told_or_said_to_be_unknown(path):
    assert is_at_work(os.getpid(), f"not-{socket.gethostname()}", path) is None
    assert is_at_work(os.getpid(), socket.gethostname(), path) is False, "no lock was ever made"
    with path.open("w"):
        assert is_at_work(os.getpid(), socket.gethostname(), path) is True
    assert is_at_work(os.getpid(), socket.gethostname(), path) is False
    path.unlink()
    tables.create(path, model="m", description="")
    with Overview(path, model="m") as overview:
        assert overview.driver() is None
        assert overview.runs() == []
    with Ledger.open(path, model="m"):
        overview = Overview(path)
        driver = overview.driver()
        assert (driver.pid, driver.host, driver.at_work) == (os.getpid(), socket.gethostname(), True)
    assert overview.driver().at_work is False
    overview.close()
