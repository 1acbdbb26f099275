"""Campaigns in worker processes and ledgers between processes: a killed driver costs only the runs under way."""

import json
import os
import random
import signal
import socket
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from tests.doors.runs.processes import pids, wait_until
from tests.unit.runs import fakes
from tests.unit.runs.fakes import Seen, batches, calls, campaign, counts, design, states, stiffnesses

from strandline.errors import LedgerError
from strandline.runs import Counts, Ledger, LocalProcesses, journal, tables
from strandline.runs.journal import VARIABLE
from strandline.runs.overview import Overview
from strandline.testing.executors import same_outcome
from strandline.testing.models import Cantilever, Counted, CrashesOnce, Faulty, Patient, Slow

ROOT = Path(__file__).parents[3]


@pytest.fixture
def path(tmp_path):
    return tmp_path / "ledger.sqlite"


@pytest.fixture
def marks(tmp_path):
    (tmp_path / "marks").mkdir()
    return tmp_path / "marks"


@pytest.mark.smoke
def test_a_run_whose_process_vanished_is_tried_again(path, marks):
    seen, model = Seen(), CrashesOnce(str(marks))
    assert states(campaign(path, model, design(300, 400), LocalProcesses(2), on_record=seen)) == ["ok", "ok"]
    assert sorted(seen.states) == ["killed", "killed", "ok", "ok"]


class Aging:
    """Worker processes whose runs `age` makes look long under way."""

    asks_again = True

    def __call__(self, model, requests):
        self.starts = requests
        yield from LocalProcesses(2)(model, requests)

    def age(self):
        for key in self.starts.begun:
            self.starts.begun[key] -= 100.0


def test_batches_are_chosen_and_made_beside_a_slow_run_by_workers_that_are_kept(path, tmp_path, marks):
    executor, shown, ended = Aging(), [], []
    model = Counted(str(tmp_path), Patient(str(marks), others=1))

    def choose(records):
        shown.append(stiffnesses(records))
        if len(shown) == 3:
            (marks / "done").touch()
        return [design(300, 350), design(450), []][len(shown) - 1]

    def note(record, progress):
        ended.append(record.inputs["E"])
        executor.age()

    done = batches(path, model, [design(600, 400)], choose, executor, on_record=note, patience=3.0)
    assert ended == [400.0, 300.0, 350.0, 450.0, 600.0]
    assert shown == [[400.0], [400.0, 300.0, 350.0], [400.0, 300.0, 350.0, 450.0]]
    assert stiffnesses(done) == [600.0, 400.0, 300.0, 350.0, 450.0]
    assert len(set(pids(tmp_path))) == 2


def test_the_time_that_the_driver_takes_for_itself_makes_no_run_slow(path, tmp_path):
    """While a record is dealt with, the other run ends; it lies there when the next batch is chosen."""
    executor, shown = Aging(), []

    def choose(records):
        shown.append(stiffnesses(records))
        return design(450) if len(shown) == 1 else []

    def pause(record, progress):
        assert wait_until(lambda: len(pids(tmp_path, "ends")) >= 2, 20)
        executor.age()

    batches(path, Counted(str(tmp_path)), [design(300, 400)], choose, executor, on_record=pause, patience=3.0)
    assert shown == [[300.0, 400.0], [300.0, 400.0, 450.0]]


def follow(folder, executor):
    """Make batches, each of which follows from the bits of all runs so far; write them down as they are chosen."""
    noted = folder / "batches"

    def choose(records):
        if len(records) >= 32:
            return []
        total = 0.0
        for record in records:
            total = (0.37 * total + 1e7 * record.interface.points[:, 1].max() ** 2) % 100.0
        batch = design(300.0 + total, 331.0 + total, 357.0 + total)
        with noted.open("a") as file:
            file.write(json.dumps(batch) + "\n")
            file.flush()
            os.fsync(file.fileno())
        return batch

    lines = noted.read_text().split("\n")[:-1] if noted.exists() else []
    first, options = [design(330, 410), *map(json.loads, lines)], {"patience": float("inf"), "maximum_attempts": 100}
    model = Counted(str(folder), Slow(seconds=0.02))
    return batches(folder / "ledger.sqlite", model, first, choose, executor, **options)


def many(folder, executor):
    """Make a campaign of 48 runs, some of which fail."""
    model = Counted(str(folder), Slow(Faulty(fault="exception", above=480.0), seconds=0.02))
    inputs = design(*(300.0 + 5.0 * k for k in range(48)))
    return campaign(folder / "ledger.sqlite", model, inputs, executor, maximum_attempts=100)


DRIVER = """
import sys
from pathlib import Path
from strandline.runs import LocalProcesses
from tests.doors.runs import test_campaign_processes as here
if __name__ == "__main__":
    getattr(here, sys.argv[1])(Path(sys.argv[2]), LocalProcesses(2))
"""


def snapshot(folder):
    """Return all runs that the ledger of a driver holds that is no more."""
    if not (folder / "ledger.sqlite").exists():
        return {}
    with Ledger.open(folder / "ledger.sqlite", model=None, read_only=True) as ledger:
        return {record.key: record for record in ledger}


def killed_in_the_middle(folder, work, rng, kept="wal"):
    """Start a driver, and kill it when it has finished some runs; return what it has left."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]), "TMPDIR": str(folder)}
    command, before = [sys.executable, "-c", DRIVER, work, str(folder)], snapshot(folder)
    with subprocess.Popen(command, env={**environment, VARIABLE: kept}) as driver:
        target = len(pids(folder, "ends")) + rng.randrange(5, 12)
        assert wait_until(lambda: len(pids(folder, "ends")) >= target, 60)
        wait_until(lambda: False, rng.uniform(0, 0.03))
        driver.send_signal(signal.SIGKILL)
    after = snapshot(folder)
    assert len(after) > len(before)
    for key, record in before.items():
        assert same_outcome(after[key], record)
        assert (after[key].seconds, after[key].message) == (record.seconds, record.message)
    return after


@pytest.mark.parametrize(("kept", "kills"), [pytest.param("wal", 1, marks=pytest.mark.smoke), ("delete", 2)])
def test_drivers_killed_at_random_moments_lose_and_repeat_nothing(path, tmp_path, monkeypatch, kept, kills):
    rng = random.Random(20220824)
    monkeypatch.setenv(VARIABLE, kept)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    for _ in range(kills):
        before = killed_in_the_middle(tmp_path, "many", rng, kept)
    assert len(before) < 48
    assert list(tmp_path.glob("strandline-runs-*"))
    done = many(tmp_path, LocalProcesses(2))
    assert not list(tmp_path.glob("strandline-runs-*")), "the next driver clears the folders of those that were killed"
    after = snapshot(tmp_path)
    assert all(same_outcome(after[key], record) for key, record in before.items())
    assert fakes.repeated(path) == 0
    assert calls(tmp_path, "ends").total() <= 48 + 2 * kills, "more was run again than what was under way"
    for record in done:
        assert record.state == ("failed" if record.inputs["E"] > 480.0 else "ok")
        if record.ok:
            direct = Cantilever()(record.inputs, tmp_path)
            assert record.interface.points.tobytes() == direct.interface.points.tobytes()
    assert counts(path) == Counts(ok=37, failed=11)


def test_batches_of_drivers_killed_at_random_moments_go_on_as_they_would_have(tmp_path):
    whole, killed, rng = tmp_path / "whole", tmp_path / "killed", random.Random(20240229)
    whole.mkdir()
    killed.mkdir()
    once = follow(whole, None)
    for _ in range(2):
        assert len(killed_in_the_middle(killed, "follow", rng)) < 32
    again = follow(killed, None)
    chosen = [entry["E"] for line in (whole / "batches").read_text().splitlines() for entry in json.loads(line)]
    assert (killed / "batches").read_text() == (whole / "batches").read_text()
    assert len(set(chosen)) == len(chosen) == 30
    assert len(once) == len(again) == 32
    assert all(same_outcome(*pair) for pair in zip(once, again, strict=True))
    assert calls(killed, "ends").total() <= 32 + 2 * 2, "more was run again than what was under way"


HOLDER = """
import sys
from strandline.runs import Ledger
with Ledger.open(sys.argv[1], model="m"):
    print("open", flush=True)
    sys.stdin.readline()
print("closed", flush=True)
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
            first.stdin.write("\n")
            first.stdin.flush()
            assert first.stdout.readline() == "closed\n"
            if Path("/proc/self/fd").is_dir():
                assert overview.driver().at_work is False
        first.communicate()
    with Overview(path) as overview:
        assert overview.driver().at_work is False
    Ledger.open(path, model="m").close()


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
    done = subprocess.run([sys.executable, "-c", script, str(path)], env={**os.environ, VARIABLE: kept})
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
        fakes.put(ledger, fakes.failed("a"))
    killed(KILLED_WHILE_WRITING, path, "delete")
    assert path.with_name("ledger.sqlite-journal").stat().st_size > 0
    with Ledger.open(path, model="m", read_only=True) as reader:
        assert reader.counts() == Counts(failed=1)
        with pytest.raises(sqlite3.OperationalError):
            reader._connection.execute("DELETE FROM starts")
    with closing(tables.connect_read_only(path)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
