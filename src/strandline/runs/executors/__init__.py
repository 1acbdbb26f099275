"""Where runs are made: in this process, in worker processes on this machine, on a Dask cluster, in jobs of SLURM.

An executor takes the model and an iterable of requests and yields one record per request, in the order in which runs
end. It pulls a request at the moment when it starts the run. `strandline.testing.executors` has the tests that any
executor must pass.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any, Protocol, cast, runtime_checkable

from strandline.models import ForwardModel
from strandline.runs.executors.local import InProcess, LocalProcesses, usable_cores
from strandline.runs.ledger.record import RunRecord, RunRequest

__all__ = ["EXECUTORS", "Executor", "InProcess", "LocalProcesses", "usable_cores", "with_workers"]

EXECUTORS = {
    "in_process": "strandline.runs.executors.local:InProcess",
    "local": "strandline.runs.executors.local:LocalProcesses",
    "dask": "strandline.runs.executors.dask:DaskCluster",
    "slurm_array": "strandline.runs.executors.slurm_array:SlurmArray",
}
"""The executors by their names in study.yaml, imported only when used."""


@runtime_checkable
class Executor(Protocol):
    """Makes runs: (model, requests) → their records, in order of completion.

    Each request is answered exactly once, whatever the simulator does, and pulled only when it is started. An executor
    with workers starts no more of them than the length hint of the requests, if they have one. A fault that
    cannot be attributed to one run (a model that cannot be loaded) raises an exception. Closing the iterator early
    stops the runs, unless they go on by themselves: such an executor has a method ``outstanding(model, keys)`` that
    returns the runs in `keys` that were started earlier and not answered, and that it will answer when requested again.

    An executor whose attribute ``asks_again`` is true may get `NOT_NOW` instead of a request: there is nothing to start
    now, but there may be later. It then pulls again as soon as it has handed over all records that it has, and not
    before, since what comes next may depend on them; it also pulls at least every half second even if nothing ends.
    `run_batches` calls such an executor once, so it keeps its workers from batch to batch and makes the next batch
    while a slow run goes on. One without this attribute never gets `NOT_NOW`; it is called for each batch.
    """

    def __call__(self, model: ForwardModel, requests: Iterable[RunRequest]) -> Iterator[RunRecord]:
        """Yield a record for each request."""
        ...


def with_workers(executor: Executor, workers: int | None) -> Executor:
    """Return `executor` with another number of workers, if it has one; None leaves it as it is."""
    if workers is None or not hasattr(executor, "workers"):
        return executor
    bounds = {name: None for name in ("minimum", "maximum") if hasattr(executor, name)}
    return cast(Executor, replace(cast(Any, executor), workers=workers, **bounds))
