"""kill -9 of drivers, workers and simulators at random moments, dozens of times, of a study with an external simulator.

The study `examples/command`, with a simulator that takes a moment. It is run once undisturbed. A copy of it is run
again and again: its driver, one of its workers, or one of the simulators is killed. Compared are the finished runs
before and after each kill, and the content of posterior.nc at the end, bit by bit.

Run it with:  python -m validation.stress [DRIVERS WORKERS SIMULATORS]
"""

import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from validation.kill_and_resume import COMMAND, finished, repeated, same_content

EXAMPLE = Path(__file__).parents[1] / "examples" / "command"
RUNS = 400
OK = ("ok",)
POLICY = "failures: {kinds: {exit_code: {retry: 20}, killed: {retry: 20}}, stop: never}\n"
"""A simulator that is killed ends with a signal, which is a failure like any other: such runs are tried again."""


def prepare(folder: Path) -> None:
    """Copy the example, with more runs, a simulator that takes a moment, and the policy."""
    shutil.copytree(EXAMPLE, folder, ignore=shutil.ignore_patterns("*.sqlite*", "*.lock", "*.json", "*.nc", "runs"))
    study, simulator = folder / "study.yaml", folder / "beam.py"
    study.write_text(study.read_text("utf-8").replace("runs: 24", f"runs: {RUNS}") + POLICY, encoding="utf-8")
    simulator.write_text(f"import time\ntime.sleep(0.1)\n{simulator.read_text('utf-8')}", encoding="utf-8")


def descendants(pid: int) -> list[tuple[int, str]]:
    """Return process numbers and command lines of all that a process has started."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            status = (path / "stat").read_text().rpartition(")")[2].split()
            found.append((int(path.name), int(status[1]), (path / "cmdline").read_bytes().decode(errors="replace")))
        except OSError:
            continue
    below, families = [], {pid}
    while True:
        new = [(one, line) for one, parent, line in found if parent in families and one not in families]
        if not new:
            return below
        below += new
        families |= {one for one, _ in new}


def victims(driver: int, kind: str) -> list[int]:
    """Return the processes of a kind that a driver has at work."""
    if kind == "driver":
        return [driver]
    mark = "beam.py" if kind == "simulator" else "strandline.runs.worker"
    return [pid for pid, line in descendants(driver) if mark in line and "supervisor" not in line]


def start(folder: Path) -> subprocess.Popen[bytes]:
    """Return a driver at work on the study."""
    return subprocess.Popen([*COMMAND, str(folder)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def wait_for_two_more(driver: subprocess.Popen[bytes], folder: Path) -> None:
    """Wait until two more runs are finished, or the driver has ended."""
    known, deadline = len(finished(folder, OK)), time.monotonic() + 60.0
    while driver.poll() is None and len(finished(folder, OK)) < known + 2 and time.monotonic() < deadline:
        time.sleep(0.02)


def main(drivers: int = 20, workers: int = 15, simulators: int = 20, seed: int = 0) -> None:
    """Print the table; end with an error where anything was repeated, lost or different."""
    rng = random.Random(seed)
    kinds = ["driver"] * drivers + ["worker"] * workers + ["simulator"] * simulators
    rng.shuffle(kinds)
    with tempfile.TemporaryDirectory(prefix="strandline-stress-") as base:
        undisturbed, disturbed = Path(base) / "undisturbed" / "s", Path(base) / "disturbed" / "s"
        for folder in (undisturbed, disturbed):
            prepare(folder)
        subprocess.run([*COMMAND, str(undisturbed)], check=True, stdout=subprocess.DEVNULL)
        done: Counter[str] = Counter()
        lost, process = 0, start(disturbed)
        for kind in kinds:
            wait_for_two_more(process, disturbed)
            time.sleep(rng.uniform(0.0, 0.3))
            before, chosen = finished(disturbed, OK), victims(process.pid, kind)
            if process.poll() is not None or not chosen:
                print(f"{kind}: none at work, {len(before)} runs finished", flush=True)
                if process.poll() is not None:
                    process = start(disturbed)
                continue
            try:
                os.kill(rng.choice(chosen), signal.SIGKILL)
            except ProcessLookupError:
                continue
            done[kind] += 1
            if kind == "driver":
                process.wait()
                process = start(disturbed)
            now = finished(disturbed, OK)
            missing = sum(now.get(key) != value for key, value in before.items())
            lost += missing
            print(f"{kind} killed: finished {len(before)} -> {len(now)}, lost {missing}", flush=True)
        if process.wait() != 0:
            raise SystemExit(f"the study ended with exit code {process.returncode}")
        again, same = repeated(disturbed, OK), same_content(undisturbed, disturbed)
        print(
            f"kills {dict(done)}, finished {len(finished(disturbed, OK))}, repeated {again}, lost {lost}, "
            f"posterior.nc content identical: {same}"
        )
        if again or lost or not same:
            raise SystemExit(1)


if __name__ == "__main__":
    main(*(int(argument) for argument in sys.argv[1:4]))
