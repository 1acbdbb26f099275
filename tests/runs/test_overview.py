"""A ledger looked at without its interfaces: the same as the records say, and who is at work."""

import os
import shutil
import socket
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from strandline.errors import LedgerError
from strandline.interface import Interface
from strandline.runs import Ledger, RunRecord, RunRequest, tables
from strandline.runs.overview import OPEN, STATES, Overview, is_at_work
from strandline.runs.record import STATES as ENDS
from strandline.studies.study_runs import settled

DATA = Path(__file__).parents[1] / "data"
LINE = Interface.polyline(np.arange(8.0).reshape(4, 2))
SLOPES = {"": {"E": np.ones((4, 2))}}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "ledger.sqlite"


def some_end(key, rng):
    state, interrupted = str(rng.choice(ENDS)), rng.random() < 0.3
    kind = None if state == "ok" else "interrupted" if state == "killed" and interrupted else f"because_{state}"
    slopes = SLOPES if state == "ok" and rng.random() < 0.5 else {}
    good = {"": LINE} if state == "ok" else {}
    return RunRecord(key, {"E": 1.0}, state, good, seconds=float(rng.random()), failure_kind=kind, sensitivities=slopes)


def at_random(ledger, rng, *, starts=150, keys=40):
    """Start runs and let most of them end, several times some."""
    for key in rng.choice([f"k{number}" for number in range(keys)], starts).tolist():
        ledger.started(RunRequest(key, {"E": 1.0}))
        if rng.random() < 0.8:
            ledger.finished(some_end(key, rng))


def test_states_are_those_of_records():
    assert (*ENDS, OPEN) == STATES


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("sensitivities", [False, True])
def test_settled_runs_are_those_of_the_records(path, seed, sensitivities):
    with Ledger.open(path, model="m") as ledger:
        at_random(ledger, np.random.default_rng(seed))
        keys = [f"k{number}" for number in range(40)]
        expected = {record.key: record for record in settled(ledger, keys, sensitivities=sensitivities)}
        counts = ledger.counts()
        with Overview(path) as overview:
            runs = overview.runs()
        found = {run.key: run.outcome for run in runs if run.settled(sensitivities=sensitivities)}
        assert set(found) == set(expected)
        assert 0 < len(found) < len(runs)
        for key, record in expected.items():
            end = found[key]
            assert (end.state, end.kind, end.seconds) == (record.state, record.failure_kind, record.seconds)
            assert end.sensitivities == bool(record.sensitivities)
        for state in STATES:
            assert sum(run.last.state == state for run in runs) == getattr(counts, state)
        assert [run.last.number for run in runs] == sorted(run.last.number for run in runs)


def test_details_are_those_of_the_record(path):
    bad = RunRecord("bad", {"E": 2.0}, "failed", {}, {"load": 0.5}, 1.0, "stalled", "why\nwhere", "a\nlog")
    with Ledger.open(path, model="m") as ledger:
        number = ledger.started(RunRequest(bad.key, bad.inputs))
        ledger.finished(bad)
        open_one = ledger.started(RunRequest("open", {"E": 3.0}))
    with Overview(path) as overview:
        details = overview.details([number, open_one])
        assert [(run.key, run.inputs) for run in overview.runs()] == [("bad", {"E": 2.0}), ("open", {"E": 3.0})]
    assert set(details) == {number}
    told = details[number]
    assert (told.message, told.log, told.diagnostics) == (bad.message, bad.log, {"load": 0.5})


@pytest.mark.parametrize("name", ["ledger-v1.sqlite", "ledger-v2.sqlite", "ledger-v2-study.sqlite"])
def test_earlier_versions_are_read(tmp_path, name):
    path = Path(shutil.copy(DATA / name, tmp_path / "ledger.sqlite"))
    before = path.read_bytes()
    with Overview(path) as overview, Ledger.open(path, model=None, read_only=True) as ledger:
        counts = ledger.counts()
        assert [sum(run.last.state == s for run in overview.runs()) for s in STATES] == [
            getattr(counts, state) for state in STATES
        ]
        assert overview.plan("any") is None
    assert path.read_bytes() == before


def test_refusals_are_those_of_the_ledger(path):
    with pytest.raises(LedgerError, match="no such file"):
        Overview(path)
    Ledger.open(path, model="m").close()
    with pytest.raises(LedgerError, match="another model"):
        Overview(path, model="other")
    path.write_bytes(b"no database" * 500)
    with pytest.raises(LedgerError, match="damaged or not a ledger"):
        Overview(path)


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


HOLDER = """
import sys
from strandline.runs import Ledger
with Ledger.open(sys.argv[1], model="m"):
    print("open", flush=True)
    sys.stdin.readline()
print("closed", flush=True)
sys.stdin.read()
"""


def test_a_driver_is_at_work_while_it_holds_the_ledger(path):
    command = [sys.executable, "-c", HOLDER, str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "open\n"
        with Overview(path) as overview:
            driver = overview.driver()
            assert (driver.pid, driver.host, driver.at_work) == (holder.pid, socket.gethostname(), True)
            with pytest.raises(LedgerError, match="locked"):  # to look took nothing away
                Ledger.open(path, model="m")
            holder.stdin.write("\n")
            holder.stdin.flush()
            assert holder.stdout.readline() == "closed\n"
            if Path("/proc/self/fd").is_dir():
                assert overview.driver().at_work is False
        holder.communicate()
    with Overview(path) as overview:
        assert overview.driver().at_work is False


def test_what_cannot_be_told_is_said_to_be_unknown(path):
    assert is_at_work(os.getpid(), f"not-{socket.gethostname()}", path) is None
    assert is_at_work(os.getpid(), socket.gethostname(), path) is False  # no lock was ever made
    with path.open("w"):
        assert is_at_work(os.getpid(), socket.gethostname(), path) is True


def test_a_ledger_without_a_driver(path):
    tables.create(path, model="m", description="")
    with Overview(path, model="m") as overview:
        assert overview.driver() is None
        assert overview.runs() == []
