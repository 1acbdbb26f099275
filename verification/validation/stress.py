"""kill -9 of drivers, workers and simulators at random moments, dozens of times, in a study with an external simulator.

The study is `examples/command` with a slower simulator. It is run once undisturbed. A copy of it is run again and
again: its driver, one of its workers, or one of the simulators is killed. The finished runs before and after each kill
and the content of posterior.nc at the end are compared bit by bit.

With `--active` the study has two unknown inputs and chooses its runs in batches. With `--journal delete` its ledger has
a rollback journal, as on a network disk.

Run it with:  python -m verification.validation.stress [--active] [--journal delete|wal] [DRIVERS WORKERS SIMULATORS]
"""

import argparse
import os
import random
import shutil
import signal
import subprocess
import tempfile
import time
from collections import Counter
from pathlib import Path

from verification.validation.kill_and_resume import COMMAND, finished, repeated, same_content

from strandline.runs.journal import VARIABLE, has_rollback_journal
from strandline.runs.scratch import PREFIX

EXAMPLE = Path(__file__).parents[2] / "examples" / "command"
RUNS, ACTIVE_RUNS = 400, 220
OK = ("ok",)
POLICY = "failures: {kinds: {killed: {retry: 20}}, stop: never}\n"
"""Killed runs are tried again: twice by default, but here the same run may be killed more often."""
ACTIVE = f"{{active: {{runs: {ACTIVE_RUNS}, initial: 40, batch: 40, change: 1.0e-9, check: 20, patience: 1000}}}}"
"""Batches until no runs are left: no posterior moves as little as `change`, and each batch waits for slow runs."""


def prepare(folder: Path, *, active: bool = False) -> None:
    """Copy the example, with more runs, a slower simulator, and the policy."""
    shutil.copytree(EXAMPLE, folder, ignore=shutil.ignore_patterns("*.sqlite*", "*.lock", "*.json", "*.nc", "runs"))
    study, simulator = folder / "study.yaml", folder / "beam.py"
    changes = {"{sobol: {runs: 24}}": ACTIVE if active else f"{{sobol: {{runs: {RUNS}}}}}"}
    if active:
        second = "  load: {prior: {uniform: [0.15, 0.25]}, unit: mN/mm}\nobservation:"
        changes |= {"observation:": second, "fixed: {load: 0.2}": "fixed: {}", "particles: 2000": "particles: 500"}
    text = study.read_text("utf-8")
    for old, new in changes.items():
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    study.write_text(text + POLICY, encoding="utf-8")
    simulator.write_text(f"import time\ntime.sleep(0.1)\n{simulator.read_text('utf-8')}", encoding="utf-8")


def descendants(pid: int) -> list[tuple[int, str]]:
    """Return process numbers and command lines of all descendants of a process."""
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
    """Return the running processes of a kind that belong to a driver."""
    if kind == "driver":
        return [driver]
    mark = "beam.py" if kind == "simulator" else "strandline.runs.worker"
    return [pid for pid, line in descendants(driver) if mark in line and "supervisor" not in line]


def start(folder: Path) -> subprocess.Popen[bytes]:
    """Start a driver on the study and return its process."""
    return subprocess.Popen([*COMMAND, str(folder)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def wait_for_two_more(driver: subprocess.Popen[bytes], folder: Path) -> None:
    """Wait until two more runs are finished, or the driver has ended."""
    known, deadline = len(finished(folder, OK)), time.monotonic() + 60.0
    while driver.poll() is None and len(finished(folder, OK)) < known + 2 and time.monotonic() < deadline:
        time.sleep(0.02)


def left_behind() -> int:
    """Return how many folders of runs are left in the temporary folder."""
    return len(list(Path(os.environ["TMPDIR"]).glob(f"{PREFIX}*")))


def main(
    drivers: int = 20,
    workers: int = 15,
    simulators: int = 20,
    *,
    active: bool = False,
    journal: str | None = None,
    seed: int = 0,
) -> None:
    """Print the table; end with an error if anything was repeated, lost or different."""
    rng, longest_wait = random.Random(seed), 1.5 if active else 0.3
    kinds = ["driver"] * drivers + ["worker"] * workers + ["simulator"] * simulators
    rng.shuffle(kinds)
    with tempfile.TemporaryDirectory(prefix="strandline-stress-") as base:
        undisturbed, disturbed = Path(base) / "undisturbed" / "s", Path(base) / "disturbed" / "s"
        os.environ["TMPDIR"] = str(Path(base) / "tmp")
        Path(base, "tmp").mkdir()
        if journal:
            os.environ[VARIABLE] = journal
        for folder in (undisturbed, disturbed):
            prepare(folder, active=active)
        begun = time.monotonic()
        subprocess.run([*COMMAND, str(undisturbed)], check=True, stdout=subprocess.DEVNULL)
        print(f"undisturbed: {len(finished(undisturbed, OK))} runs in {time.monotonic() - begun:.0f} s", flush=True)
        done: Counter[str] = Counter()
        lost, process = 0, start(disturbed)
        for kind in kinds:
            wait_for_two_more(process, disturbed)
            time.sleep(rng.uniform(0.0, longest_wait))
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
        rollback, folders = has_rollback_journal(disturbed / "ledger.sqlite"), left_behind()
        print(
            f"journal {'delete' if rollback else 'wal'}, {time.monotonic() - begun:.0f} s, folders left {folders}, "
            f"kills {dict(done)}, finished {len(finished(disturbed, OK))}, repeated {again}, lost {lost}, "
            f"posterior.nc content identical: {same}"
        )
        if again or lost or folders or not same or rollback != (journal == "delete"):
            raise SystemExit(1)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m verification.validation.stress")
    parser.add_argument("--active", action="store_true", help="a study that chooses its runs in batches")
    parser.add_argument("--journal", choices=["delete", "wal"], help="of the ledger, if not as the disk needs it")
    parser.add_argument("kills", nargs="*", type=int, help="how many drivers, workers and simulators are killed")
    given = parser.parse_args()
    main(*given.kills, active=given.active, journal=given.journal)
