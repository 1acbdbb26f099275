"""How long the quick commands take, from the shell and back: `strandline --help`, `status` and `runs`.

They are timed on a study whose ledger holds the runs of its design; `status` also after a change of study.yaml, so that
it has to load the study. A bare interpreter is timed for comparison. Times depend on the machine and its load.
"""

import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from verification.benchmarks.forward import Figure

from strandline.design import sobol
from strandline.runs import InProcess, Ledger, run_campaign
from strandline.studies import load_study
from strandline.testing.studies import write_study

RUNS, REPEATS = 200, 9
HELP_AIM, STATUS_AIM = 0.15, 0.6
"""Seconds."""
COMMAND = "from strandline.cli import main; main()"


def main() -> list[dict[str, Any]]:
    """Print each figure as it is made; return them all."""
    print(f"{'task':<28} {'case':<28} {'value':>9}")
    found = []
    with tempfile.TemporaryDirectory(prefix="strandline-") as folder:
        for figure in figures(cantilever_study(Path(folder) / "study", RUNS), repeats=REPEATS):
            found.append(asdict(figure))
            print(
                f"{figure.what:<28} {figure.case:<28} {figure.value:>9.3g} {figure.unit:<4} {figure.remark}", flush=True
            )
    return found


def figures(study: Path, *, repeats: int) -> Iterator[Figure]:
    """Yield the median wall time of each command; study.yaml is changed before the last one."""
    yield measured("interpreter", "nothing else", ["pass"], repeats)
    yield measured("strandline --help", "", [COMMAND, "--help"], repeats, aim=HELP_AIM)
    yield measured("strandline status", "plan in the ledger", [COMMAND, "status", str(study)], repeats, aim=STATUS_AIM)
    yield measured("strandline runs", "", [COMMAND, "runs", str(study)], repeats)
    cantilever_study(study, RUNS, make=False, seed=2)
    yield measured("strandline status", "study.yaml changed", [COMMAND, "status", str(study)], repeats)


def measured(what: str, case: str, arguments: Sequence[str], repeats: int, *, aim: float | None = None) -> Figure:
    """Return the median wall time of a command in its own process, after one call that fills the disk cache."""
    first, *times = (seconds(arguments) for _ in range(repeats + 1))
    remark = f"median of {repeats}, {min(times):.3g} to {max(times):.3g}; the first time {first:.3g} s"
    return Figure(what, case, statistics.median(times), "s", remark + (f"; aim {aim:g} s" if aim else ""))


def seconds(arguments: Sequence[str]) -> float:
    begun = time.perf_counter()
    subprocess.run([sys.executable, "-c", *arguments], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - begun


def cantilever_study(folder: Path, runs: int, *, make: bool = True, seed: int = 1) -> Path:
    """Write a study of the bent `Cantilever` and make the runs of its design as a driver would; return the folder."""
    write_study(
        folder,
        name="cantilever",
        model={"python": {"function": "strandline.testing.models:TwoLoads.beam"}},
        inputs={"E": {"prior": {"uniform": [300, 560]}, "unit": "Pa"}},
        fixed={"load": 1e-5},
        observation={"synthetic": {"E": 400, "load": 1e-5}},
        design={"sobol": {"runs": runs}},
        seed=seed,
    )
    study = load_study(folder)
    inputs = [{**study.fixed, **study.space.as_mapping(x)} for x in study.space.to_physical(sobol(runs, 1))]
    if make:
        with Ledger.open(study.ledger_path, model=study.model, description=study.name) as ledger:
            ledger.plan(study.runs.plan)
            run_campaign(study.model, inputs, ledger=ledger, executor=InProcess())
    return folder
