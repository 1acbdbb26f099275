"""What campaigns on a real SLURM survive: a fault is injected after the first run, and the campaign is watched.

A SLURM of three virtual nodes with two CPUs each is started for it. Each campaign has twelve runs of three seconds
(Dask: six). The seconds count from the fault until the last run that it hit has ended well, including three for the run
itself; if it hit none, until the next run ends.

Run it with:  python -m verification.validation.slurm_faults
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from verification.private_slurm import TemporarySlurm, missing_programs, temporary_slurm

from strandline.models.python import PythonModel
from strandline.runs import Executor, Ledger, RunRecord, run_campaign
from strandline.runs.executors.dask import DaskCluster
from strandline.runs.executors.slurm_array import SlurmArray
from strandline.testing.models import Faulty, Slow

ROOT = Path(__file__).parents[2]
RUNS, DASK_RUNS = 12, 6
POLL = 0.5
SECONDS = 3.0
slow_beam = Slow(seconds=SECONDS)
hanging_beam = Faulty(base=Slow(seconds=SECONDS), fault="hang", above=352.0)
JOBS = {"cores": 1, "memory": "400MB", "walltime": "00:30:00", "interface": "lo"}


@dataclass(frozen=True)
class Seen:
    """Outcome of a campaign: how often each end occurred, the seconds until it went on, and the total seconds."""

    fault: str
    ends: Counter[str]
    seconds: float
    total: float
    complete: bool

    def row(self) -> str:
        """Return the outcome as a row of the table."""
        told = ", ".join(f"{count} {end}" for end, count in self.ends.most_common())
        told += "; complete" if self.complete else "; NOT COMPLETE"
        return f"| {self.fault} | {told} | {self.seconds:.1f} | {self.total:.0f} |"


def main() -> None:
    """Print the table, each row as soon as it is known."""
    if missing_programs():
        sys.exit(f"no {', '.join(missing_programs())}: apt-get install slurmctld slurmd slurm-client munge")
    os.environ["PYTHONPATH"] = f"{ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    print("| fault injected | ends of all attempts | seconds until it went on | seconds in all |")
    print("| --- | --- | --- | --- |")
    with temporary_slurm() as slurm:
        for case in CASES:
            with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
                os.chdir(folder)
                print(case(slurm, Path(folder)).row(), flush=True)
                os.chdir(ROOT)
                slurm.quiet()


def array(folder: Path, target: str = "slow_beam", **options: Any) -> tuple[PythonModel, SlurmArray]:
    """Return a model from this file and the executor whose jobs find it by its name."""
    name = f"verification.validation.slurm_faults:{target}"
    command = (sys.executable, "-m", "strandline.runs.array_task", name)
    return PythonModel(name), SlurmArray(folder / "slurm", command, poll=POLL, **options)


def watched(
    fault: str, folder: Path, model: Any, executor: Executor, disturb: Callable[[], object], *, number: int = RUNS
) -> Seen:
    """Run a campaign and call `disturb` after its first run."""
    began, ends, hit = time.monotonic(), list[tuple[float, RunRecord]](), [0.0]

    def note(record: RunRecord, progress: object) -> None:
        ends.append((time.monotonic(), record))
        if len(ends) == 1:
            disturb()
            hit[0] = time.monotonic()

    inputs = [{"E": 300.0 + 5.0 * k, "load": 1e-5} for k in range(number)]
    with Ledger.open(folder / "ledger.sqlite", model=model) as ledger:
        done = run_campaign(model, inputs, ledger=ledger, executor=executor, on_record=note)
    return seen(fault, ends, hit[0], began, complete=all(record.final for record in done))


def seen(fault: str, ends: list[tuple[float, RunRecord]], hit: float, began: float, *, complete: bool) -> Seen:
    """Return the outcome of a campaign from the ends of its attempts."""
    lost = {record.key for _, record in ends if record.state == "killed"}
    mended = [at for at, record in ends if record.ok and record.key in lost and at > hit]
    others = [at for at, record in ends if at > hit]
    seconds = (max(mended) if mended else min(others)) - hit
    counts = Counter(record.failure_kind or record.state for _, record in ends)
    return Seen(fault, counts, seconds, ends[-1][0] - began, complete)


def running(slurm: TemporarySlurm) -> list[list[str]]:
    """Return number and node of the running jobs, after a moment: by then, jobs that ended with the first are gone."""
    time.sleep(2.0)
    text = slurm.command("squeue", "--noheader", "--array", "--states=RUNNING", "--format=%i|%N")
    return [line.split("|") for line in text.split()]


def nothing(slurm: TemporarySlurm, folder: Path) -> Seen:
    """Watch an undisturbed campaign."""
    return watched("array: none", folder, *array(folder), lambda: None)


def cancelled(slurm: TemporarySlurm, folder: Path) -> Seen:
    """Cancel one job."""

    def disturb() -> None:
        slurm.command("scancel", running(slurm)[-1][0])

    return watched("array: `scancel` of one job", folder, *array(folder), disturb)


def node_down(slurm: TemporarySlurm, folder: Path) -> Seen:
    """Take a node with running jobs out of service."""

    def disturb() -> None:
        slurm.command("scontrol", "update", f"nodename={running(slurm)[-1][1]}", "state=down", "reason=test")

    return watched("array: a node set down", folder, *array(folder), disturb)


def controller(slurm: TemporarySlurm, folder: Path) -> Seen:
    """Kill SLURM's controller, as a crash of its machine would, and start it again."""

    def disturb() -> None:
        (submitted,) = (folder / "slurm").glob("*/job")
        slurm.kill_controller(saved_after=submitted.stat().st_mtime)
        time.sleep(3.0)
        slurm.start_controller()

    return watched("array: the controller killed, started again after 3 s", folder, *array(folder), disturb)


def walltime(slurm: TemporarySlurm, folder: Path) -> Seen:
    """Let a run exceed its job's walltime."""

    model, executor = array(folder, "hanging_beam", walltime="00:01:00")
    return watched("array: one run of 12 hangs, walltime 1 min", folder, model, executor, lambda: None)


def inside_timeout(slurm: TemporarySlurm, folder: Path) -> Seen:
    """Let a run exceed its own timeout."""

    model, executor = array(folder, "hanging_beam", timeout=4.0)
    return watched("array: one run of 12 hangs, timeout 4 s", folder, model, executor, lambda: None)


def driver_killed(slurm: TemporarySlurm, folder: Path) -> Seen:
    """Kill the driver of a campaign; the seconds count from the next driver's start until its first record."""
    model, executor = array(folder)
    code = (
        "import sys; from pathlib import Path; import verification.validation.slurm_faults as faults\n"
        "folder = Path(sys.argv[1]); faults.watched('', folder, *faults.array(folder), lambda: None)"
    )
    with subprocess.Popen([sys.executable, "-c", code, str(folder)]) as driver:
        while ok_runs(folder) < 3:
            time.sleep(0.05)
        driver.send_signal(signal.SIGKILL)
    kept, began, ends = ok_runs(folder), time.monotonic(), list[tuple[float, RunRecord]]()
    inputs = [{"E": 300.0 + 5.0 * k, "load": 1e-5} for k in range(RUNS)]
    with Ledger.open(folder / "ledger.sqlite", model=model) as ledger:
        done = run_campaign(
            model, inputs, ledger=ledger, executor=executor, on_record=lambda r, p: ends.append((time.monotonic(), r))
        )
        repeated = sum(ledger.attempts(record.key) - 1 for record in done)
    counts = Counter({"ok before": kept, "ok after": len(ends), "repeated": repeated})
    complete = all(record.ok for record in done) and repeated == 0
    fault = "array: driver killed with SIGKILL, another one started"
    return Seen(fault, counts, ends[0][0] - began, ends[-1][0] - began, complete)


def full_queue(slurm: TemporarySlurm, folder: Path) -> Seen:
    """Fill the nodes for five seconds first."""
    for _ in range(6):
        slurm.command("sbatch", "--output=/dev/null", "--wrap=sleep 5")
    return watched("array: all nodes taken by other jobs of 5 s", folder, *array(folder), lambda: None)


def dask_cancelled(slurm: TemporarySlurm, folder: Path) -> Seen:
    """Cancel the job that is the only Dask worker."""

    def disturb() -> None:
        slurm.command("scancel", running(slurm)[-1][0])

    executor = DaskCluster(cluster="slurm", workers=1, jobs=JOBS)
    return watched("Dask, one job: `scancel` of it", folder, slow_beam, executor, disturb, number=DASK_RUNS)


def dask_node_down(slurm: TemporarySlurm, folder: Path) -> Seen:
    """Take the node of the only Dask worker out of service."""

    def disturb() -> None:
        slurm.command("scontrol", "update", f"nodename={running(slurm)[-1][1]}", "state=down", "reason=test")

    executor = DaskCluster(cluster="slurm", workers=1, jobs=JOBS)
    return watched("Dask, one job: its node set down", folder, slow_beam, executor, disturb, number=DASK_RUNS)


def ok_runs(folder: Path) -> int:
    """Return how many successful runs the ledger has."""
    if not (folder / "ledger.sqlite").is_file():
        return 0
    with Ledger.open(folder / "ledger.sqlite", model=None, read_only=True) as ledger:
        return ledger.counts().ok


CASES = (
    nothing,
    driver_killed,
    cancelled,
    node_down,
    controller,
    inside_timeout,
    walltime,
    full_queue,
    dask_cancelled,
    dask_node_down,
)

if __name__ == "__main__":
    main()
