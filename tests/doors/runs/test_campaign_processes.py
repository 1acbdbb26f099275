"""Campaigns in worker processes and ledgers between processes: a killed driver costs only the runs under way."""

import json
import math
import os
import random
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tests.doors.runs.dying import CrashesOnce
from tests.doors.runs.processes import pids, wait_until
from tests.unit.runs import fakes
from tests.unit.runs.fakes import Seen, batches, calls, campaign, design, states, stiffnesses

from strandline.foundations import LedgerError
from strandline.runs import Counts, Ledger, LocalProcesses
from strandline.runs.ledger.journal import VARIABLE
from strandline.runs.ledger.overview import Overview
from strandline.testing.executors import same_outcome
from strandline.testing.models import Counted, Faulty, Slow

ROOT = Path(__file__).parents[3]


@pytest.fixture
def path(tmp_path):
    return tmp_path / "ledger.sqlite"


@pytest.mark.smoke
def test_a_run_whose_process_vanished_is_tried_again(path, tmp_path):
    seen, model = Seen(), CrashesOnce(str(tmp_path))
    assert states(campaign(path, model, design(300, 400), LocalProcesses(2), on_record=seen)) == ["ok", "ok"]
    assert sorted(seen.states) == ["killed", "killed", "ok", "ok"]


class Kept:
    """Two worker processes; keeps the requests, which know when each run began."""

    asks_again = True

    def __call__(self, model, requests):
        self.starts = requests
        yield from LocalProcesses(2)(model, requests)


def test_the_time_that_the_driver_takes_for_itself_makes_no_run_slow(path, tmp_path):
    """While a record is dealt with, the other run ends; it lies there when the next batch is chosen.

    The workers are kept from batch to batch; one of them may make all runs.
    """
    executor, shown = Kept(), []

    def choose(records):
        shown.append(stiffnesses(records))
        return design(450) if len(shown) == 1 else []

    def pause(record, progress):
        assert wait_until(lambda: len(pids(tmp_path, "ends")) >= 2, 20)
        time.sleep(0.5)  # the other run has ended; its record is on the way
        executor.starts.begun |= {key: begun - 100.0 for key, begun in executor.starts.begun.items()}

    batches(path, Counted(str(tmp_path)), [design(300, 400)], choose, executor, on_record=pause, patience=3.0)
    assert shown == [[300.0, 400.0], [300.0, 400.0, 450.0]]
    assert len(set(pids(tmp_path))) <= 2


def follow(folder, executor):
    """Make batches, each of which follows from the bits of all runs so far, some of which fail; note what is chosen."""
    noted = folder / "batches"

    def choose(records):
        if len(records) >= 33:
            return []
        total = 0.0
        for record in records:
            height = record.interface.points[:, 1].max() if record.ok else 1.0
            total = (0.37 * total + 1e7 * height**2) % 100.0
        batch = design(300.0 + total, 331.0 + total, 357.0 + total)
        with noted.open("a") as file:
            file.write(json.dumps(batch) + "\n")
            file.flush()
            os.fsync(file.fileno())
        return batch

    lines = noted.read_text().split("\n")[:-1] if noted.exists() else []
    first, options = [design(330, 410, 500), *map(json.loads, lines)], {"patience": math.inf, "maximum_attempts": 100}
    model = Counted(str(folder), Slow(Faulty(fault="exception", above=430.0), seconds=0.02))
    return batches(folder / "ledger.sqlite", model, first, choose, executor, **options)


DRIVER = """
import sys
from pathlib import Path
from strandline.runs import LocalProcesses
from tests.doors.runs.test_campaign_processes import follow
if __name__ == "__main__":
    follow(Path(sys.argv[1]), LocalProcesses(2))
"""


def snapshot(folder):
    """Return all runs that the ledger of a driver holds that is no more."""
    if not (folder / "ledger.sqlite").exists():
        return {}
    with Ledger.open(folder / "ledger.sqlite", model=None, read_only=True) as ledger:
        return {record.key: record for record in ledger}


def killed_in_the_middle(folder, rng, kept):
    """Start a driver, and kill it when it has finished some runs; return what it has left."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]), "TMPDIR": str(folder)}
    command, before = [sys.executable, "-c", DRIVER, str(folder)], snapshot(folder)
    with subprocess.Popen(command, env={**environment, VARIABLE: kept}) as driver:
        target = len(pids(folder, "ends")) + rng.randrange(5, 12)
        assert wait_until(lambda: len(pids(folder, "ends")) >= target, 60)
        wait_until(lambda: False, rng.uniform(0, 0.03))
        driver.send_signal(signal.SIGKILL)
    after = snapshot(folder)
    assert len(after) > len(before)
    assert all(same_outcome(after[key], record) for key, record in before.items())
    return after


@pytest.mark.parametrize(("kept", "kills"), [pytest.param("wal", 1, marks=pytest.mark.smoke), ("delete", 2)])
def test_drivers_killed_at_random_moments_lose_and_repeat_nothing_and_go_on_as_they_would_have(
    tmp_path, monkeypatch, kept, kills
):
    whole, killed, rng = tmp_path / "whole", tmp_path / "killed", random.Random(20240229)
    monkeypatch.setenv(VARIABLE, kept)
    monkeypatch.setattr("tempfile.tempdir", str(killed))
    for folder in (whole, killed):
        folder.mkdir()
    for _ in range(kills):
        before = killed_in_the_middle(killed, rng, kept)
    assert len(before) < 33
    assert list(killed.glob("strandline-runs-*"))
    again = follow(killed, LocalProcesses(2))
    assert not list(killed.glob("strandline-runs-*")), "the next driver clears the folders of the killed ones"
    after = snapshot(killed)
    assert all(same_outcome(after[key], record) for key, record in before.items())
    assert fakes.repeated(killed / "ledger.sqlite") == 0
    assert calls(killed, "ends").total() <= 33 + 2 * kills, "more was run again than what was under way"
    once = follow(whole, None)
    chosen = [entry["E"] for line in (whole / "batches").read_text().splitlines() for entry in json.loads(line)]
    assert (killed / "batches").read_text() == (whole / "batches").read_text()
    assert len(set(chosen)) == len(chosen) == 30
    assert states(once[:3]) == ["ok", "ok", "failed"]
    assert all(same_outcome(*pair) for pair in zip(once, again, strict=True))


HOLDER = """
import sys
from strandline.runs import Ledger
with Ledger.open(sys.argv[1], model="m"):
    print("open", flush=True)
    sys.stdin.read()
"""


@pytest.mark.smoke
def test_a_second_driver_is_refused_and_told_who_the_first_is(path):
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", HOLDER, str(path)], stdin=pipe, stdout=pipe, text=True) as first:
        assert first.stdout.readline() == "open\n"
        with pytest.raises(LedgerError, match=f"locked.*another run is using it.*process {first.pid} "):
            Ledger.open(path, model="m")
        with Ledger.open(path, model="m", read_only=True) as reader, Overview(path) as overview:
            assert reader.counts().total == 0
            found = overview.driver()
            assert (found.pid, found.host, found.at_work) == (first.pid, socket.gethostname(), True)
            with pytest.raises(LedgerError, match="locked"):  # to look took nothing away
                Ledger.open(path, model="m")
        first.communicate()
    with Overview(path) as overview:
        assert overview.driver().at_work is False
    Ledger.open(path, model="m").close()


KILLED_WHILE_WRITING = """
import os, signal, sqlite3, sys
from strandline.runs.ledger import ledger_schema
connection = ledger_schema.connect(sys.argv[1])
connection.execute("PRAGMA cache_size = 1")
connection.execute("BEGIN IMMEDIATE")
for k in range(300):
    connection.execute("INSERT INTO starts (session, key, inputs, started_at) VALUES (1, ?, '{}', 0)", (str(k) * 500,))
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_driver_had_only_begun_to_write_is_undone_by_a_reader(path, monkeypatch):
    monkeypatch.setenv(VARIABLE, "delete")
    with Ledger.open(path, model="m") as ledger:
        fakes.put(ledger, fakes.failed("a"))
    done = subprocess.run([sys.executable, "-c", KILLED_WHILE_WRITING, str(path)])
    assert done.returncode == -signal.SIGKILL
    assert path.with_name("ledger.sqlite-journal").stat().st_size > 0
    with Ledger.open(path, model="m", read_only=True) as reader:
        assert reader.counts() == Counts(failed=1)
