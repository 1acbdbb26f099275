"""A worker process that makes one run at a time, for callers that have no list of runs but wait for each one."""

import pickle
import shutil
import tempfile
from multiprocessing.connection import wait
from pathlib import Path

from strandline.models.protocol import ForwardModel
from strandline.runs.executors.seat import KILLED_STARTS_BORNE, killed_while_starting
from strandline.runs.record import RunRecord, RunRequest
from strandline.runs.workers import Worker

LOOKED_AFTER_SECONDS = 0.25


class OnCall:
    """Makes runs of `model` in a separate process, replaced if a run crashes it; call it from one thread only.

    The process starts with the first run and lives until `close`.

    Args:
        model: Model defined in a module that can be imported.
        timeout: Seconds after which a run is killed; None: never.
    """

    def __init__(self, model: ForwardModel, *, timeout: float | None = None) -> None:
        self._timeout = timeout
        self._folder = tempfile.TemporaryDirectory(prefix="strandline-on-call-", ignore_cleanup_errors=True)
        self._setup = Path(self._folder.name) / "model.pickle"
        self._setup.write_bytes(pickle.dumps((None, pickle.dumps(model))))
        self._worker: Worker | None = None
        self._launched = 0
        self._closed = False

    def __call__(self, request: RunRequest) -> RunRecord:
        """Return the record of the run, however it ends.

        Raises:
            InvalidInput: the process cannot load the model.
        """
        worker = self._ready()
        workdir = Path(self._folder.name) / "run"
        workdir.mkdir()
        try:
            worker.send(request, workdir, self._timeout)
            return self._heard(worker)
        except (EOFError, OSError):
            if self._closed:
                return _stopped(request)
            return self._lost(worker, worker.vanished())
        finally:
            shutil.rmtree(workdir, ignore_errors=True)

    def close(self) -> None:
        """End the process at once, and with it a run that another thread is waiting for."""
        self._closed = True
        if self._worker is not None:
            self._worker.hang_up()
            self._worker.end()
            self._worker = None
        self._folder.cleanup()

    def _ready(self) -> Worker:
        """Return a worker that has loaded the model; replace one that ended while idle."""
        if self._worker is not None and self._worker.gone():
            self._drop(self._worker)
        killed = 0
        while self._worker is None:
            self._launched += 1
            worker = Worker.launch(Path(self._folder.name), self._launched, self._setup)
            try:
                worker.receive()
                self._worker = worker
            except (EOFError, OSError):
                worker.vanished()
                worker.end()
                killed += 1
            except BaseException:
                worker.end()
                raise
            if killed > KILLED_STARTS_BORNE:
                raise killed_while_starting(killed)
        return self._worker

    def _heard(self, worker: Worker) -> RunRecord:
        """Return the record that the worker sends, or one that says how the worker ended."""
        while True:
            if wait([worker.connection], timeout=LOOKED_AFTER_SECONDS):
                record = worker.receive()
                if record is not None:
                    return record
            elif worker.overdue():
                return self._lost(worker, worker.out_of_time(self._timeout or 0.0))
            elif worker.gone() and not self._closed:
                return self._lost(worker, worker.vanished())

    def _lost(self, worker: Worker, record: RunRecord | None) -> RunRecord:
        self._drop(worker)
        assert record is not None  # it was making a run
        return record

    def _drop(self, worker: Worker) -> None:
        worker.end()
        self._worker = None


def _stopped(request: RunRequest) -> RunRecord:
    return RunRecord(request.key, request.inputs, "killed", failure_kind="stopped", message="stopped with its process")
