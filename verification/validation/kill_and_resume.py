"""kill -9 of drivers, workers and simulators at random moments: no finished run is lost or repeated.

The study is `examples/command` with a slower simulator. It is run once undisturbed. A copy of it is run again and
again: its driver, one of its workers, or one of the simulators is killed. The finished runs before and after each kill
and the content of posterior.nc at the end are compared bit by bit.

With `--active` the study has two unknown inputs and chooses its runs in batches. With `--journal delete` its ledger has
a rollback journal, as on a network disk.

    python -m verification.validation.kill_and_resume [--active] [--journal delete|wal]
        [--drivers 20] [--workers 15] [--simulators 20]
"""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from contextlib import closing, suppress
from pathlib import Path

import psutil
import yaml
from verification.validation.tables import EXAMPLES, arguments, kept_or_scratch

from strandline.posterior import read
from strandline.runs.ledger.journal import VARIABLE, has_rollback_journal
from strandline.runs.ledger.ledger_schema import connect_read_only
from strandline.runs.worker import PREFIX

COMMAND = [sys.executable, "-m", "strandline", "run", "--quiet"]
RUNS, ACTIVE_RUNS = 400, 220
FINISHED = "SELECT key, attempt FROM starts JOIN outcomes USING (attempt) WHERE state = 'ok'"
POLICY = {"kinds": {"killed": {"retry": 20}}, "stop": "never"}
"""Killed runs are tried again: twice by default, but here the same run may be killed more often."""
ACTIVE = {"runs": ACTIVE_RUNS, "initial": 40, "batch": 40, "change": 1e-9, "check": 20, "patience": 1000}
"""Batches until no runs are left: no posterior moves as little as `change`, and each batch waits for slow runs."""


def prepare(folder: Path, runs: int, *, active: bool) -> None:
    """Copy the example, with more runs, a slower simulator, and the policy."""
    shutil.copytree(
        EXAMPLES / "command", folder, ignore=shutil.ignore_patterns("*.sqlite*", "*.lock", "*.json", "*.nc", "runs")
    )
    study, simulator = folder / "study.yaml", folder / "beam.py"
    content = yaml.safe_load(study.read_text("utf-8")) | {"failures": POLICY, "design": {"sobol": {"runs": runs}}}
    if active:
        content |= {"design": {"active": ACTIVE}, "fixed": {}}
        content["inputs"]["load"] = {"prior": {"uniform": [0.15, 0.25]}, "unit": "mN/mm"}
        content["sampler"]["smc"]["particles"] = 500
    study.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    simulator.write_text(f"import time\ntime.sleep(0.1)\n{simulator.read_text('utf-8')}", encoding="utf-8")


def finished(folder: Path) -> list[tuple[str, int]]:
    """Return key and attempt of each outcome of a successful run."""
    if not (folder / "ledger.sqlite").is_file():
        return []
    with closing(connect_read_only(folder / "ledger.sqlite")) as connection:
        return connection.execute(FINISHED).fetchall()


def _victims(driver: int, kind: str) -> list[int]:
    if kind == "driver":
        return [driver]
    mark, found = "beam.py" if kind == "simulator" else "strandline.runs.worker", []
    with suppress(psutil.Error):  # the driver has ended
        for process in psutil.Process(driver).children(recursive=True):
            with suppress(psutil.Error):  # this one has
                line = " ".join(process.cmdline())
                found += [process.pid] if mark in line and "supervisor" not in line else []
    return found


def _start(folder: Path, environment: dict[str, str]) -> subprocess.Popen[bytes]:
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return subprocess.Popen([*COMMAND, str(folder)], env=os.environ | environment, **quiet)


def _wait_for_two_more(driver: subprocess.Popen[bytes], folder: Path) -> None:
    known, deadline = len(finished(folder)), time.monotonic() + 60.0
    while driver.poll() is None and len(finished(folder)) < known + 2 and time.monotonic() < deadline:
        time.sleep(0.02)


def disturb(
    folder: Path, environment: dict[str, str], kinds: list[str], rng: random.Random, longest_wait: float
) -> tuple[Counter[str], int]:
    """Run the study to its end and kill a process of each kind meanwhile; return kills and the number of lost runs."""
    done, lost, process = Counter[str](), 0, _start(folder, environment)
    for kind in kinds:
        _wait_for_two_more(process, folder)
        time.sleep(rng.uniform(0.0, longest_wait))
        before, chosen = finished(folder), _victims(process.pid, kind)
        if process.poll() is not None or not chosen:
            print(f"{kind}: none at work, {len(before)} runs finished", flush=True)
            if process.poll() is not None:
                process = _start(folder, environment)
            continue
        try:
            os.kill(rng.choice(chosen), signal.SIGKILL)
        except ProcessLookupError:
            continue
        done[kind] += 1
        if kind == "driver":
            process.wait()
            process = _start(folder, environment)
        now = finished(folder)
        missing = len(set(before) - set(now))
        lost += missing
        print(f"{kind} killed: finished {len(before)} -> {len(now)}, lost {missing}", flush=True)
    if process.wait() != 0:
        raise SystemExit(f"the study ended with exit code {process.returncode}")
    return done, lost


def main(
    drivers: int, workers: int, simulators: int, *, active: bool = False, journal: str = "", runs: int = RUNS
) -> None:
    """Print the table; end with an error if anything was repeated, lost or different."""
    rng = random.Random(0)
    kinds = ["driver"] * drivers + ["worker"] * workers + ["simulator"] * simulators
    rng.shuffle(kinds)
    with kept_or_scratch(None) as base:
        undisturbed, disturbed = base / "undisturbed" / "s", base / "disturbed" / "s"
        environment = {"TMPDIR": str(base / "tmp")} | ({VARIABLE: journal} if journal else {})
        (base / "tmp").mkdir()
        for folder in (undisturbed, disturbed):
            prepare(folder, runs, active=active)
        begun = time.monotonic()
        if _start(undisturbed, environment).wait() != 0:
            raise SystemExit("the study fails undisturbed")
        print(f"undisturbed: {len(finished(undisturbed))} runs in {time.monotonic() - begun:.0f} s", flush=True)
        done, lost = disturb(disturbed, environment, kinds, rng, 1.5 if active else 0.3)
        outcomes, results = finished(disturbed), [read(one / "posterior.nc") for one in (undisturbed, disturbed)]
        same = results[0].identical(results[1])
        again = len(outcomes) - len({key for key, _ in outcomes})
        rollback = has_rollback_journal(disturbed / "ledger.sqlite")
        folders = len(list((base / "tmp").glob(f"{PREFIX}*")))
    print(
        f"journal {'delete' if rollback else 'wal'}, {time.monotonic() - begun:.0f} s, folders left {folders}, "
        f"kills {dict(done)}, finished {len(outcomes)}, repeated {again}, lost {lost}, "
        f"posterior.nc content identical: {same}"
    )
    if again or lost or folders or not same or rollback != (journal == "delete"):
        raise SystemExit(1)


if __name__ == "__main__":
    given = arguments(__doc__, drivers=20, workers=15, simulators=20, active=False, journal="")
    main(**vars(given))
