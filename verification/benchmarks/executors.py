"""What a run costs in addition to the model: a beam with a closed form, a thousand runs, by each executor.

The time before the first record, in which workers start, is given separately. Times depend on the machine and its
load: the best of the repeats is reported.
"""

import time
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from verification.benchmarks.forward import Figure

from strandline.runs import Executor, InProcess, LocalProcesses
from strandline.runs.executors.dask import DaskCluster
from strandline.testing.executors import requests_for
from strandline.testing.models import Cantilever

RUNS = 1000
REPEATS = 3
EXECUTORS: dict[str, Callable[[], Executor]] = {
    "in process": InProcess,
    "2 worker processes": lambda: LocalProcesses(2),
    "Dask, 2 workers": lambda: DaskCluster(workers=2),
}


def main() -> list[dict[str, Any]]:
    """Print each figure as it is made; return them all."""
    found = []
    print(f"{'task':<28} {'case':<20} {'value':>9}")
    for name, executor in EXECUTORS.items():
        per_run, first = map(min, zip(*(overhead(executor()) for _ in range(REPEATS)), strict=True))
        figures = [
            Figure(f"overhead a run, {RUNS} runs", name, 1000 * per_run, "ms", "aims: 5 ms local, 20 ms Dask"),
            Figure("until the first record", name, first, "s", ""),
        ]
        for figure in figures:
            found.append(asdict(figure))
            print(
                f"{figure.what:<28} {figure.case:<20} {figure.value:>9.3g} {figure.unit:<4} {figure.remark}", flush=True
            )
    return found


def overhead(executor: Executor) -> tuple[float, float]:
    """Return the seconds per run, for all runs but the first, and the seconds until the first record."""
    requests = requests_for(Cantilever(), [300.0 + 0.1 * number for number in range(RUNS)])
    begin = time.perf_counter()
    records = iter(executor(Cantilever(), requests))
    if not next(records).ok:
        raise RuntimeError("the beam's run failed")
    first = time.perf_counter() - begin
    if sum(record.ok for record in records) != RUNS - 1:
        raise RuntimeError("runs failed or are missing")
    return (time.perf_counter() - begin - first) / (RUNS - 1), first


if __name__ == "__main__":
    main()
