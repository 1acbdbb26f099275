"""Ledgers between processes: one driver at a time, readers beside it, and what a killed one leaves."""

import os
import signal
import socket
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from tests.doors.runs.processes import wait_until
from tests.unit.runs.ledgers import failed, put

from strandline.errors import LedgerError
from strandline.runs import Counts, Ledger, journal, tables
from strandline.runs.journal import VARIABLE
from strandline.runs.overview import Overview

DRIVER = """
import sys
from strandline.runs import Ledger
with Ledger.open(sys.argv[1], model="m"):
    print("open", flush=True)
    sys.stdin.readline()
print("closed", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "ledger.sqlite"


@pytest.mark.smoke
def test_a_second_driver_is_refused_and_told_who_the_first_is(path):
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", DRIVER, str(path)], stdin=pipe, stdout=pipe, text=True) as first:
        assert first.stdout.readline() == "open\n"
        with pytest.raises(LedgerError, match=f"locked.*another run is using it.*process {first.pid} "):
            Ledger.open(path, model="m")
        with Ledger.open(path, model="m", read_only=True) as reader, Overview(path) as overview:
            assert reader.counts().total == 0
            found = overview.driver()
            assert (found.pid, found.host, found.at_work) == (first.pid, socket.gethostname(), True)
            with pytest.raises(LedgerError, match="locked"):  # to look took nothing away
                Ledger.open(path, model="m")
            first.stdin.write("\n")
            first.stdin.flush()
            assert first.stdout.readline() == "closed\n"
            if Path("/proc/self/fd").is_dir():
                assert overview.driver().at_work is False
        first.communicate()
    with Overview(path) as overview:
        assert overview.driver().at_work is False
    Ledger.open(path, model="m").close()


WRITER = """
import select, sys
from strandline.runs import Ledger, RunRecord, RunRequest
with Ledger.open(sys.argv[1], model="m") as ledger:
    for k in range(100_000):
        if select.select([sys.stdin], [], [], 0.02)[0]:
            break
        ledger.started(RunRequest(str(k), {}))
        ledger.finished(RunRecord(str(k), {}, "failed"))
"""


def test_a_reader_beside_a_driver_of_another_process_sees_whole_runs(path):
    environment, seen = {**os.environ, VARIABLE: "delete"}, []

    def look():
        with Ledger.open(path, model="m", read_only=True) as reader:
            seen.append(len(list(reader)))
            assert reader.counts().open <= 1
        return len(set(seen)) >= 3

    with subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdin=subprocess.PIPE, env=environment) as writer:
        assert wait_until(path.exists, 30)
        assert wait_until(look, 30)
        writer.communicate()
    assert writer.returncode == 0
    assert seen == sorted(seen)


KILLED_WITH_A_LOG = """
import os, signal, sys
from strandline.runs import Ledger, RunRecord, RunRequest
ledger = Ledger.open(sys.argv[1], model="m")
for key in "abc":
    ledger.started(RunRequest(key, {}))
    ledger.finished(RunRecord(key, {}, "failed"))
os.kill(os.getpid(), signal.SIGKILL)
"""
KILLED_WHILE_WRITING = """
import os, signal, sqlite3, sys
from strandline.runs import tables
connection = tables.connect(sys.argv[1])
connection.execute("PRAGMA cache_size = 1")
connection.execute("BEGIN IMMEDIATE")
for k in range(300):
    connection.execute("INSERT INTO starts (session, key, inputs, started_at) VALUES (1, ?, '{}', 0)", (str(k) * 500,))
os.kill(os.getpid(), signal.SIGKILL)
"""


def killed(script, path, kept):
    done = subprocess.run([sys.executable, "-c", script, str(path)], env={**os.environ, VARIABLE: kept}, check=False)
    assert done.returncode == -signal.SIGKILL


def test_a_ledger_with_a_log_is_converted_and_keeps_what_is_in_the_log(path, monkeypatch):
    killed(KILLED_WITH_A_LOG, path, "wal")
    log = path.with_name("ledger.sqlite-wal")
    assert log.stat().st_size > 0
    monkeypatch.setenv(VARIABLE, "delete")
    with Ledger.open(path, model="m") as ledger:
        assert ledger.counts() == Counts(failed=3)
    assert not log.exists()
    assert journal.has_rollback_journal(path)


def test_what_a_killed_driver_had_only_begun_to_write_is_undone_by_a_reader(path, monkeypatch):
    monkeypatch.setenv(VARIABLE, "delete")
    with Ledger.open(path, model="m") as ledger:
        put(ledger, failed("a"))
    killed(KILLED_WHILE_WRITING, path, "delete")
    assert path.with_name("ledger.sqlite-journal").stat().st_size > 0
    with Ledger.open(path, model="m", read_only=True) as reader:
        assert reader.counts() == Counts(failed=1)
        with pytest.raises(sqlite3.OperationalError):
            reader._connection.execute("DELETE FROM starts")
    with closing(tables.connect_read_only(path)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
