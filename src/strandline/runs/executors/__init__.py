"""Where runs are made: in this process, or in worker processes on this machine.

An executor takes the model and an iterable of requests and yields one record per request, in the order in which runs
end. It pulls a request in the moment in which it starts it. `strandline.testing.executors` has the tests that any
executor must pass.
"""

from collections.abc import Iterable, Iterator
from typing import Protocol, runtime_checkable

from strandline.models.protocol import ForwardModel
from strandline.runs.executors.in_process import InProcess
from strandline.runs.executors.local import LocalProcesses, usable_cores
from strandline.runs.record import RunRecord, RunRequest

__all__ = ["EXECUTORS", "Executor", "InProcess", "LocalProcesses", "usable_cores"]

EXECUTORS = {
    "in_process": "strandline.runs.executors.in_process:InProcess",
    "local": "strandline.runs.executors.local:LocalProcesses",
}
"""The executors by their names in study.yaml, imported when they are asked for."""


@runtime_checkable
class Executor(Protocol):
    """Makes runs: (model, requests) → their records, in order of completion.

    Each request is answered exactly once, whatever the simulator does, and pulled only when it is started. What
    cannot be attributed to one run (a model that cannot be loaded) is an exception. Closing the iterator early stops
    the runs.
    """

    def __call__(self, model: ForwardModel, requests: Iterable[RunRequest]) -> Iterator[RunRecord]:
        """Yield a record for each request."""
        ...
