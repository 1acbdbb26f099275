"""Dask workers live on between the batches of an active design, and nothing of it shows in the results."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import pytest

from strandline.runs import InProcess, Ledger, run_batches
from strandline.runs.executors.dask import DaskCluster
from strandline.testing.executors import WAITING_CHECKS, same_outcome
from strandline.testing.models import Cantilever

pytest.importorskip("distributed", reason="the extra `dask` is not installed")
pytest.importorskip("cryptography", reason="the extra `dask` is not installed")
SIZE, BATCHES = 4, 3


@pytest.fixture(scope="module")
def scheduler():
    """Start a scheduler with two workers, each a process of its own, and return its address."""
    from distributed import LocalCluster

    quiet = {"dashboard_address": "127.0.0.1:0", "silence_logs": 50}
    with LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", memory_limit=0, **quiet) as cluster:
        yield cluster.scheduler_address


@pytest.mark.parametrize("check", WAITING_CHECKS.values(), ids=WAITING_CHECKS.keys())
def test_dask_waits_for_what_follows(check, scheduler):
    check(DaskCluster(address=scheduler), workers=2)


@pytest.mark.long
def test_one_dask_worker_hands_over_before_it_asks_again():
    WAITING_CHECKS["hands_over_before_it_asks_again"](DaskCluster(workers=1), workers=1)


@dataclass(frozen=True)
class Loaded:
    """A cantilever that leaves a line wherever a process loads it."""

    folder: str
    fingerprint: ClassVar[str] = "test:loaded"

    def __reduce__(self):
        return load, (self.folder,)

    def __call__(self, inputs, workdir):
        time.sleep(0.05)
        return Cantilever()(inputs, workdir)


def load(folder):
    with (Path(folder) / "loads").open("a") as lines:
        lines.write(f"{os.getpid()} {os.getppid()}\n")
    return Loaded(folder)


def loads(folder: Path) -> list[tuple[int, int]]:
    """Return the processes that have loaded the model, and their parents."""
    path = folder / "loads"
    lines = path.read_text().splitlines() if path.exists() else []
    return [(int(line.split()[0]), int(line.split()[1])) for line in lines]


def batch_after(stiffness: float) -> list[dict[str, float]]:
    return [{"E": stiffness + 10.0 * k, "load": 1e-5} for k in range(SIZE)]


class Choice:
    """Chooses a batch that follows, digit by digit, from what the runs before it returned."""

    def __init__(self, between=lambda number: None):
        self.between, self.asked = between, 0

    def __call__(self, records):
        if len(records) >= SIZE * BATCHES:
            return []
        self.asked += 1
        self.between(self.asked)
        tip = sum(float(abs(found.points).sum()) for record in records for found in record.interfaces.values())
        return batch_after(300.0 + 1000.0 * (tip % 1.0))


def campaign(folder, executor, choice):
    model = Loaded(str(folder))
    with Ledger.open(folder / "ledger.sqlite", model=model) as ledger:
        return run_batches(model, [batch_after(300.0)], choice, ledger=ledger, executor=executor)


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    """Return the records of the same campaign in one process."""
    return campaign(tmp_path_factory.mktemp("expected"), InProcess(), Choice())


def require_alike(records, expected):
    assert len(records) == SIZE * BATCHES
    assert all(same_outcome(one, other) for one, other in zip(records, expected, strict=True))


def test_each_worker_is_started_once(tmp_path, expected):
    require_alike(campaign(tmp_path, DaskCluster(workers=2), Choice()), expected)
    assert 1 <= len(loads(tmp_path)) <= 2  # one that comes late may find nothing to do
    assert not any(alive(process) or alive(above) for process, above in loads(tmp_path))


@pytest.mark.long
def test_a_worker_killed_between_batches_is_replaced(tmp_path, expected):
    """The Dask worker before the second batch; the process beside it, which makes the runs, before the third."""
    shot = []

    def kill(number):
        process = loads(tmp_path)[-1][2 - number]
        os.kill(process, signal.SIGKILL)
        shot.append(process)
        assert wait_until(lambda: not alive(process), 10)
        time.sleep(1.2)  # as long as learning may take: the driver's last look at the workers is out of date

    require_alike(campaign(tmp_path, DaskCluster(workers=1), Choice(kill)), expected)
    assert len(shot) == 2
    assert len(loads(tmp_path)) == 3
    with Ledger.open(tmp_path / "ledger.sqlite", model=None, read_only=True) as ledger:
        assert {ledger.attempts(record.key) for record in ledger} == {1}


@pytest.mark.long
@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_nothing_is_left_behind_after_an_error_between_batches(tmp_path, error):
    def stop(number):
        assert all(alive(process) for process, _ in loads(tmp_path))
        raise error

    with pytest.raises(error):
        campaign(tmp_path, DaskCluster(workers=2), Choice(stop))
    assert 1 <= len(loads(tmp_path)) <= 2
    everything = [number for line in loads(tmp_path) for number in line]
    assert wait_until(lambda: not any(alive(process) for process in everything), 10)


DRIVER = """
import sys, time
from pathlib import Path
from tests.runs.test_dask_batches import Choice, campaign
from strandline.runs.executors.dask import DaskCluster
def between(number):
    (Path(sys.argv[1]) / f"chosen-{number}").touch()
    time.sleep(60 if number == 2 else 0)
if __name__ == "__main__":
    campaign(Path(sys.argv[1]), DaskCluster(workers=2), Choice(between))
"""


@pytest.mark.long
def test_a_driver_killed_between_batches_is_followed_by_one_that_goes_on(tmp_path, expected):
    root = Path(__file__).parents[2]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(root), *sys.path])}
    with subprocess.Popen([sys.executable, "-c", DRIVER, str(tmp_path)], env=environment) as driver:
        try:
            assert wait_until((tmp_path / "chosen-2").exists, 60)
        finally:
            driver.kill()
    everything = [number for line in loads(tmp_path) for number in line]
    assert wait_until(lambda: not any(alive(process) for process in everything), 30)
    require_alike(campaign(tmp_path, DaskCluster(workers=2), Choice()), expected)
    assert len(loads(tmp_path)) <= 4
    with Ledger.open(tmp_path / "ledger.sqlite", model=None, read_only=True) as ledger:
        assert {ledger.attempts(record.key) for record in ledger} == {1}


def alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def wait_until(condition, seconds):
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.02)
    return condition()
