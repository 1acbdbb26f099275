"""kill -9 of the driver and of workers at random moments: no finished run is repeated or lost, the result is the same.

A study (real biofilm model, coarse mesh) is run once undisturbed. A copy of it is run again and again: first its driver
is killed at random moments, then single workers, until it has finished. The finished runs before and after each kill
and the content of posterior.nc at the end are compared bit by bit.

Run it with:  python -m verification.validation.kill_and_resume [DRIVER_KILLS WORKER_KILLS]
"""

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np

from strandline.posterior import read
from strandline.runs.ledger_schema import connect_read_only
from strandline.studies.template import write_template

RUNS = 160
COMMAND = [sys.executable, "-m", "strandline", "run", "--quiet"]


OWN_ACCOUNT = ("ok", "failed")
"""How runs end that were not killed."""


def finished(folder: Path, states: Sequence[str] = OWN_ACCOUNT) -> dict[str, str]:
    """Return attempt and state of every run that has ended in one of `states`, by key."""
    if not (folder / "ledger.sqlite").is_file():
        return {}
    sql = f"SELECT key, attempt, state FROM starts JOIN outcomes USING (attempt) WHERE state IN ({_marks(states)})"
    return {key: f"{attempt}:{state}" for key, attempt, state in _rows(folder, sql, states)}


def repeated(folder: Path, states: Sequence[str] = OWN_ACCOUNT) -> int:
    """Return how many runs have more than one outcome in one of `states`."""
    sql = f"SELECT key FROM starts JOIN outcomes USING (attempt) WHERE state IN ({_marks(states)})"
    return len(_rows(folder, f"{sql} GROUP BY key HAVING count(*) > 1", states))


def _rows(folder: Path, sql: str, values: Sequence[str]) -> list[tuple[str, ...]]:
    with closing(connect_read_only(folder / "ledger.sqlite")) as connection:
        return connection.execute(sql, values).fetchall()


def _marks(values: Sequence[str]) -> str:
    return ",".join("?" * len(values))


def prepare(folder: Path, runs: int) -> None:
    """Write the study."""
    path = write_template(folder)
    text = path.read_text(encoding="utf-8")
    for old, new in (
        ("{active: {runs: 80}}", f"{{sobol: {{runs: {runs}}}}}"),
        ("{field: {}}", "{log_likelihood: {}}"),
        (f"name: {folder.name}", "name: s"),
    ):
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")


def children(pid: int) -> list[int]:
    """Return the worker processes of a driver."""
    path = Path(f"/proc/{pid}/task/{pid}/children")
    found = [int(p) for p in path.read_text().split()] if path.exists() else []
    return [p for p in found if b"resource_tracker" not in Path(f"/proc/{p}/cmdline").read_bytes()]


def kill_driver(folder: Path, after: float) -> str:
    """Start the study, kill its driver `after` seconds after the first new outcome, and describe what was lost."""
    before = finished(folder)
    process = subprocess.Popen([*COMMAND, str(folder)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None and len(finished(folder)) <= len(before):
        time.sleep(0.02)
    time.sleep(after)
    if process.poll() is None:
        process.send_signal(signal.SIGKILL)
    process.wait()
    now = finished(folder)
    lost = sum(now.get(key) != value for key, value in before.items())
    return f"driver killed after {after:4.1f} s: finished {len(before)} -> {len(now)}, lost {lost}"


def kill_workers(folder: Path, number: int, rng: random.Random, runs: int) -> list[str]:
    """Run the study of so many runs to its end, and kill `number` workers meanwhile."""
    process = subprocess.Popen([*COMMAND, str(folder)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    lines = []
    while len(lines) < number and process.poll() is None:
        time.sleep(rng.uniform(0.5, 2.0))
        workers = children(process.pid)
        before = finished(folder)
        if workers and len(before) < runs - 5:
            victim = rng.choice(workers)
            os.kill(victim, signal.SIGKILL)
            lines.append(f"worker killed: finished then {len(before)}")
    if process.wait() != 0:
        raise SystemExit(f"the study ended with exit code {process.returncode} after a worker was killed")
    return lines


def same_content(first: Path, second: Path) -> bool:
    """Compare two posterior.nc files: groups, variables, attributes, every bit of every value."""
    a, b = (read(folder / "posterior.nc") for folder in (first, second))
    if a.groups != b.groups or a.attrs != b.attrs:
        return False
    for group in a.groups:
        left, right = a[group].to_dataset(), b[group].to_dataset()
        if list(left.variables) != list(right.variables) or left.attrs != right.attrs:
            return False
        for name in left.variables:
            x, y = np.asarray(left[name]), np.asarray(right[name])
            if x.dtype != y.dtype or x.shape != y.shape or x.tobytes() != y.tobytes():
                return False
    return True


def main(driver_kills: int = 5, worker_kills: int = 3, seed: int = 0, *, runs: int = RUNS) -> None:
    """Print the table; end with an error if anything was repeated, lost or different."""
    rng = random.Random(seed)
    with tempfile.TemporaryDirectory(prefix="strandline-kill-") as base:
        undisturbed, disturbed = Path(base) / "undisturbed", Path(base) / "disturbed"
        for folder in (undisturbed, disturbed):
            prepare(folder, runs)
        subprocess.run([*COMMAND, str(undisturbed)], check=True, stdout=subprocess.DEVNULL)
        for _ in range(driver_kills):
            print(kill_driver(disturbed, rng.uniform(0.0, 3.0)), flush=True)
        for line in kill_workers(disturbed, worker_kills, rng, runs):
            print(line, flush=True)
        again, same = repeated(disturbed), same_content(undisturbed, disturbed)
        print(f"finished {len(finished(disturbed))}, repeated {again}, posterior.nc content identical: {same}")
        if again or not same:
            raise SystemExit(1)


if __name__ == "__main__":
    main(*(int(argument) for argument in sys.argv[1:3]))
