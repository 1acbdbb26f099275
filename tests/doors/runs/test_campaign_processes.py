"""Campaigns in worker processes; a killed driver costs nothing but the runs that it was making."""

import json
import os
import random
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from tests.doors.runs.processes import pids, wait_until
from tests.unit.runs.fakes import Seen, batches, calls, campaign, counts, design, repeated, states, stiffnesses

from strandline.runs import Counts, Ledger, LocalProcesses
from strandline.runs.journal import VARIABLE
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
    return batches(
        folder / "ledger.sqlite", Counted(str(folder), Slow(seconds=0.02)), first, choose, executor, **options
    )


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


def killed_in_the_middle(folder, work, rng, journal="wal"):
    """Start a driver, and kill it when it has finished some runs; return what it has left."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]), "TMPDIR": str(folder)}
    command, before = [sys.executable, "-c", DRIVER, work, str(folder)], snapshot(folder)
    with subprocess.Popen(command, env={**environment, VARIABLE: journal}) as driver:
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


@pytest.mark.parametrize(("journal", "kills"), [pytest.param("wal", 1, marks=pytest.mark.smoke), ("delete", 2)])
def test_drivers_killed_at_random_moments_lose_and_repeat_nothing(tmp_path, monkeypatch, journal, kills):
    rng = random.Random(20220824)
    monkeypatch.setenv(VARIABLE, journal)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    for _ in range(kills):
        before = killed_in_the_middle(tmp_path, "many", rng, journal)
    assert len(before) < 48
    assert list(tmp_path.glob("strandline-runs-*"))
    done = many(tmp_path, LocalProcesses(2))
    assert not list(tmp_path.glob("strandline-runs-*")), "the next driver clears the folders of those that were killed"
    after = snapshot(tmp_path)
    assert all(same_outcome(after[key], record) for key, record in before.items())
    assert repeated(tmp_path / "ledger.sqlite") == 0
    assert calls(tmp_path, "ends").total() <= 48 + 2 * kills, "more was run again than what was under way"
    for record in done:
        assert record.state == ("failed" if record.inputs["E"] > 480.0 else "ok")
        if record.ok:
            direct = Cantilever()(record.inputs, tmp_path)
            assert record.interface.points.tobytes() == direct.interface.points.tobytes()
    assert counts(tmp_path / "ledger.sqlite") == Counts(ok=37, failed=11)


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
