"""How long the quick commands take, from the shell and back: `strandline --help`, `status` and `runs`.

They are timed on a study whose ledger holds the runs of its design; `status` also after a change of study.yaml, so that
it has to load the study. A bare interpreter is timed for comparison. Times depend on the machine and its load.
"""

import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from verification.benchmarks.figures import Figure, timed

from strandline.runs import InProcess, run_campaign
from strandline.studies import load_study
from strandline.testing.studies import write_study

RUNS, REPEATS = 200, 9
COMMAND = "from strandline.cli import main; main()"


def figures() -> Iterator[Figure]:
    """Yield the median wall time of each command; study.yaml is changed before the last one."""
    with tempfile.TemporaryDirectory(prefix="strandline-") as folder:
        study = Path(folder) / "study"
        write(study, seed=1)
        make_runs(study)
        yield measured("interpreter", "nothing else", ["pass"])
        yield measured("strandline --help", "", [COMMAND, "--help"])
        yield measured("strandline status", "plan in the ledger", [COMMAND, "status", str(study)])
        yield measured("strandline runs", "", [COMMAND, "runs", str(study)])
        write(study, seed=2)
        yield measured("strandline status", "study.yaml changed", [COMMAND, "status", str(study)])


def measured(what: str, case: str, arguments: Sequence[str]) -> Figure:
    """Return the median wall time of a command in its own process, after one call that fills the disk cache."""
    command = partial(subprocess.run, [sys.executable, "-c", *arguments], check=True, stdout=subprocess.DEVNULL)
    first, *times = (timed(command) for _ in range(REPEATS + 1))
    remark = f"median of {REPEATS}, {min(times):.3g} to {max(times):.3g}; the first time {first:.3g} s"
    return Figure(what, case, statistics.median(times), "s", remark)


def write(folder: Path, *, seed: int) -> None:
    """Write a study of the bent `Cantilever`."""
    write_study(
        folder,
        name="cantilever",
        model={"python": {"function": "strandline.testing.models:TwoLoads.beam"}},
        inputs={"E": {"prior": {"uniform": [300, 560]}, "unit": "Pa"}},
        fixed={"load": 1e-5},
        observation={"synthetic": {"E": 400, "load": 1e-5}},
        design={"sobol": {"runs": RUNS}},
        seed=seed,
    )


def make_runs(folder: Path) -> None:
    """Make the runs of a study's design as a driver would."""
    study = load_study(folder)
    with study.runs.ledger() as ledger:
        ledger.plan(study.runs.plan)
        run_campaign(study.model, study.runs.design, ledger=ledger, executor=InProcess())
