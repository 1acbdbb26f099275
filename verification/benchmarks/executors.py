"""What a run costs in addition to the model: a beam with a closed form, a thousand runs, by each executor.

The time before the first record, in which workers start, is given separately. Times depend on the machine and its
load: the best of the repeats is reported.
"""

import time
from collections.abc import Callable, Iterator

from verification.benchmarks.figures import Figure

from strandline.runs import Executor, InProcess, LocalProcesses
from strandline.runs.executors.dask import DaskCluster
from strandline.testing.executors import requests_for
from strandline.testing.models import Cantilever

RUNS, REPEATS = 1000, 3
EXECUTORS: dict[str, Callable[[], Executor]] = {
    "in process": InProcess,
    "2 worker processes": lambda: LocalProcesses(2),
    "Dask, 2 workers": lambda: DaskCluster(workers=2),
}


def figures() -> Iterator[Figure]:
    """Yield what a run costs by each executor, and the time until the first record."""
    for name, executor in EXECUTORS.items():
        per_run, first = map(min, zip(*(overhead(executor()) for _ in range(REPEATS)), strict=True))
        yield Figure(f"overhead a run, {RUNS} runs", name, 1000 * per_run, "ms")
        yield Figure("until the first record", name, first)


def overhead(executor: Executor, runs: int = RUNS) -> tuple[float, float]:
    """Return the seconds per run, for all runs but the first, and the seconds until the first record."""
    requests = requests_for(Cantilever(), [300.0 + 0.1 * number for number in range(runs)])
    begin = time.perf_counter()
    records = iter(executor(Cantilever(), requests))
    if not next(records).ok:
        raise RuntimeError("the beam's run failed")
    first = time.perf_counter() - begin
    if sum(record.ok for record in records) != runs - 1:
        raise RuntimeError("runs failed or are missing")
    return (time.perf_counter() - begin - first) / (runs - 1), first
