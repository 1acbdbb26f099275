"""Runs as the jobs of SLURM arrays, which go on without a driver: for long runs, and for runs that use MPI.

The executor keeps no essential state in memory: what was submitted and what has come back is in the folders of its
batches. If a driver was killed or left, another one can collect the results. What one job does is at the end;
`strandline.studies.array_task` is the command for the model of a study.
"""

import contextlib
import re
import shlex
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from strandline.foundations import InvalidInput, StrandlineError, end_of, require, unfit
from strandline.models import ForwardModel, asks_sensitivities, fingerprint, with_sensitivities
from strandline.runs.executors import shared, slurm_batch
from strandline.runs.executors.slurm_batch import ArrayBatch, SlurmUnreachable, read_run
from strandline.runs.ledger.record import RunRecord, RunRequest, State, ended, with_log
from strandline.runs.worker import WorkerSlot, packed_model

__all__ = ["UNUSABLE", "Detached", "SlurmArray"]

UNUSABLE = "model_not_loaded"
"""Failure kind of a run whose job could not load the model: this does not count as a result of the run."""
LOOKS_FOR_A_LATE_RESULT = 4
"""Number of checks of a job that ended without a result, which may still be on its way through a file system."""
WARNING_SECONDS = 45
"""How long before the end of its walltime a job is warned, if that is at most a tenth of the walltime."""
GOING = frozenset({"PENDING", "RUNNING", "CONFIGURING", "COMPLETING", "SUSPENDED", "STAGE_OUT", "SIGNALING", "STOPPED"})
ENDINGS: Mapping[str, tuple[State, str]] = {
    "TIMEOUT": ("timeout", "walltime"),
    "DEADLINE": ("timeout", "walltime"),
    "NODE_FAIL": ("killed", "node_failed"),
    "BOOT_FAIL": ("killed", "node_failed"),
    "OUT_OF_MEMORY": ("killed", "out_of_memory"),
    "CANCELLED": ("killed", "cancelled"),
    "PREEMPTED": ("killed", "preempted"),
}
"""How a run ended if its job left no result, by the state of the job; for other states, its process died."""
SBATCH = {"time": "walltime", "partition": "partition", "account": "account", "cpus-per-task": "cpus", "mem": "memory"}
"""Our options by the names that ``sbatch`` has for them."""
MEMORY_KILL = re.compile(r"^slurmstepd\S*: error: .*exceeded .*memory limit", re.IGNORECASE | re.MULTILINE)
"""What only a job's output says if SLURM watches its memory without cgroups (OverMemoryKill): the job is ``FAILED``."""


class Detached(StrandlineError):
    """Everything that can be submitted is submitted, and the driver does not wait; `number` runs are out."""

    def __init__(self, number: int) -> None:
        self.number = number
        super().__init__(f"{number} runs are with SLURM")


@dataclass(frozen=True)
class SlurmArray:
    """Runs as jobs of SLURM arrays, one run per job; they go on even if the driver does not.

    Args:
        folder: Folder of the batches, on a file system that the nodes see.
        command: Command that a job runs, followed by the batch's folder and the run's number;
            `strandline.studies.array_task` shows what it must do.
        timeout: Seconds after which a run is killed; default: never.
        walltime: Walltime of a job, in quotes as for ``dask``; a run that reaches its end is a ``timeout``; default:
            the partition's.
        partition: Partition; default: the cluster's.
        account: Account to charge; default: the user's.
        cpus: CPUs per job.
        memory: Memory per job, ``8G``.
        max_running: Maximum number of running jobs.
        max_jobs: Maximum number of jobs with SLURM; default: all.
        extra: Further ``sbatch`` options.
        poll: Seconds between polls.
        detach: Whether to submit and leave, by raising `Detached`.

    Raises:
        InvalidInput: options that make no sense; a timeout that the walltime does not leave room for.
    """

    folder: Path
    command: tuple[str, ...]
    timeout: float | None = None
    walltime: str | None = None
    partition: str | None = None
    account: str | None = None
    cpus: int | None = None
    memory: str | None = None
    max_running: int | None = None
    max_jobs: int | None = None
    extra: tuple[str, ...] = ()
    poll: float = 5.0
    detach: bool = False

    def __post_init__(self) -> None:
        shared.require_seconds("timeout", self.timeout)
        shared.require_seconds("poll", self.poll, remedy="Correct the number.")
        for name in ("cpus", "max_running", "max_jobs"):
            shared.require_count(name, getattr(self, name), remedy="Correct the number.")
        if self.walltime is not None:
            shared.walltime_seconds(self.walltime)
        shared.require_room_in_walltime(self.timeout, self.walltime)

    def outstanding(self, model: ForwardModel, keys: Iterable[str]) -> frozenset[str]:
        """Return the runs in `keys` that SLURM still has, or that are done but not collected.

        Raises:
            SlurmUnreachable: SLURM does not answer.
        """
        return frozenset(self._known(model)) & frozenset(keys)

    def __call__(self, model: ForwardModel, requests: Iterable[RunRequest]) -> Iterator[RunRecord]:
        """Yield a record for each request as results appear; runs that are outstanding are not submitted again.

        Raises:
            InvalidInput: SLURM accepts no jobs, or a job cannot load the model.
            Detached: all runs are submitted, and `detach` is set.
        """
        return _ArrayRuns(self, model, iter(requests)).records()

    def options(self, number: int) -> list[str]:
        """Return the options of ``sbatch`` for an array of `number` jobs."""
        given = {name: getattr(self, option) for name, option in SBATCH.items()}
        limit = "" if self.max_running is None else f"%{self.max_running}"
        # The campaign, which counts attempts, tries a run again; SLURM, which does not count them, must not.
        warning = int(min(WARNING_SECONDS, shared.walltime_seconds(self.walltime or "1-0") / 10))
        fixed = [f"--array=0-{number - 1}{limit}", "--no-requeue", f"--signal=B:USR1@{warning}"]
        return [*fixed, *(f"--{name}={value}" for name, value in given.items() if value is not None), *self.extra]

    def _known(self, model: ForwardModel) -> dict[str, tuple[ArrayBatch, int]]:
        """Return batch and number of each run that was submitted and not collected; the latest batch counts."""
        known: dict[str, tuple[ArrayBatch, int]] = {}
        for batch in slurm_batch.known_batches(self.folder):
            if batch.sensitivities < asks_sensitivities(model):
                continue
            there, taken = batch.present()
            if not there and batch.job is None and not _found(batch):
                continue
            for index, request in enumerate(batch.requests):
                known.pop(request.key, None)
                if index not in taken:
                    known[request.key] = batch, index
        return known


class _ArrayRuns:
    """One call: the runs that are out, and those that wait for room."""

    def __init__(self, options: SlurmArray, model: ForwardModel, requests: Iterator[RunRequest]) -> None:
        self.options, self.model, self.requests = options, model, requests
        self.exhausted = False
        self.waiting: list[RunRequest] = []
        self.out: dict[str, tuple[ArrayBatch, int, RunRequest]] = {}
        self.ended: dict[str, int] = {}

    def records(self) -> Iterator[RunRecord]:
        """Yield each record as its run ends, and submit arrays until no request is left."""
        known = self.options._known(self.model)
        while True:
            self._pull(known)
            self._submit()
            if self.exhausted and not self.out and not self.waiting:
                return
            if self.options.detach and not self.waiting and (self.exhausted or self.options.max_jobs):
                raise Detached(len(self.out))
            found = False
            for key, record in self._news():
                found = True
                yield record
                batch, index, _ = self.out.pop(key)
                batch.take(index)
            if found:
                self._tidy()
            else:
                time.sleep(self.options.poll)

    def _pull(self, known: Mapping[str, tuple[ArrayBatch, int]]) -> None:
        """Pull what there is room for if at least half of the room is free, so that arrays do not become tiny."""
        most = self.options.max_jobs
        if self.exhausted or (most is not None and len(self.out) + len(self.waiting) > most // 2):
            return
        while most is None or len(self.out) + len(self.waiting) < most:
            request = next(self.requests, None)
            if request is None:
                self.exhausted = True
                return
            if request.key in known:
                self.out[request.key] = (*known[request.key], request)
            else:
                self.waiting.append(request)

    def _submit(self) -> None:
        """Submit the waiting runs in the largest possible arrays; runs that SLURM refuses wait while others are out."""
        if not self.waiting:
            return
        try:
            largest = slurm_batch.largest_array()
            while self.waiting:
                batch = self._submitted(self.waiting[:largest])
                for index, request in enumerate(batch.requests):
                    self.out[request.key] = batch, index, request
                del self.waiting[:largest]
        except SlurmUnreachable:
            if not self.out:
                raise

    def _submitted(self, requests: Sequence[RunRequest]) -> ArrayBatch:
        self.options.folder.mkdir(parents=True, exist_ok=True)
        batch = ArrayBatch.new(self.options.folder.resolve(), self.model, requests, self.options.timeout)
        script = batch.folder / "job.sh"
        command = shlex.join([*self.options.command, str(batch.folder)])
        # A warning must not kill a job that does not handle it yet: SLURM then reports the end of the walltime.
        lines = ["#!/bin/bash", "trap '' USR1", f'exec {command} "$SLURM_ARRAY_TASK_ID"', ""]
        script.write_text("\n".join(lines), encoding="utf-8")
        logs = str(batch.folder / "logs" / "A.txt").replace("%", "%%").removesuffix("A.txt") + "%a.txt"
        place = [f"--job-name={batch.name}", f"--output={logs}", f"--chdir={batch.folder}"]
        try:
            batch.submitted(slurm_batch.submit_job([*place, *self.options.options(len(requests))], script))
        except InvalidInput:
            if not _found(batch):  # a submission whose answer was lost still counts
                batch.remove()
                raise
        return batch

    def _news(self) -> Iterator[tuple[str, RunRecord]]:
        batches = {batch.name: batch for batch, _, _ in self.out.values()}
        there = {name: batch.present()[0] for name, batch in batches.items()}
        for key, (batch, index, request) in list(self.out.items()):
            if index in there[batch.name]:
                yield key, self._read(batch, index, request, there[batch.name][index])
        if not self.out:
            return
        with contextlib.suppress(SlurmUnreachable):
            yield from self._lost(slurm_batch.job_states(batches), there)

    def _lost(
        self, states: Mapping[tuple[str, int], str], there: Mapping[str, Mapping[int, Path]]
    ) -> Iterator[tuple[str, RunRecord]]:
        """Yield records of runs whose jobs have ended without leaving one."""
        for key, (batch, index, request) in list(self.out.items()):
            state = states.get((batch.name, index))
            if state in GOING or index in there[batch.name]:
                self.ended.pop(key, None)
                continue
            self.ended[key] = self.ended.get(key, 0) + 1
            if self.ended[key] > LOOKS_FOR_A_LATE_RESULT:
                del self.ended[key]
                state = state or (slurm_batch.past_state(batch.job, index) if batch.job else None)
                yield key, _without_result(batch, index, request, state)

    def _read(self, batch: ArrayBatch, index: int, request: RunRequest, path: Path) -> RunRecord:
        try:
            record = read_run(path)
        except InvalidInput as error:
            return ended(request, "killed", "damaged_result", str(error))
        if record.failure_kind == UNUSABLE:
            with contextlib.suppress(SlurmUnreachable):
                slurm_batch.cancel_jobs(batch.name)
            batch.remove()
            what = "a job could not load the model"
            expected = "a model that the nodes can load as this machine does"
            remedy = "Fix that and run again; the jobs of this array are cancelled."
            raise unfit(what, (record.message or "").splitlines()[0], expected, remedy)
        return record

    def _tidy(self) -> None:
        """Remove the batches whose results are all taken; the ledger has them."""
        needed = {batch.name for batch, _, _ in self.out.values()}
        for batch in slurm_batch.known_batches(self.options.folder):
            if batch.name not in needed and len(batch.present()[1]) == len(batch.requests):
                batch.remove()


def _found(batch: ArrayBatch) -> bool:
    """Return whether SLURM has the job of a batch whose driver could not note its number; if so, note it."""
    if (job := slurm_batch.job_called(batch.name)) is not None:
        batch.submitted(job)
    return job is not None


def _without_result(batch: ArrayBatch, index: int, request: RunRequest, job_state: str | None) -> RunRecord:
    """Return the record of a run whose job ended with this state and left no result."""
    word = (job_state or "").split("+")[0]
    log = end_of(batch.folder / "logs" / f"{index}.txt")
    died = "out_of_memory" if MEMORY_KILL.search(log) else "worker_died"
    state, kind = ENDINGS.get(word, ("killed", died))
    told = f"SLURM says {job_state}" if job_state else "SLURM no longer knows it"
    message = f"job {batch.job}_{index} of this run ended without a result; {told}"
    return with_log(ended(request, state, kind, message), log)


def run_task(folder: Path, index: int, load: Callable[[], ForwardModel]) -> None:
    """Make one run of the batch in `folder`, of the model that `load` returns, and write its record, unless it has one.

    A crash, a hang and the end of the walltime, of which SLURM warns by SIGUSR1, become records.
    """
    walltime_over = threading.Event()
    signal.signal(signal.SIGUSR1, lambda number, frame: walltime_over.set())
    try:
        batch = ArrayBatch.read(folder)
    except FileNotFoundError:
        return  # the batch was given up meanwhile
    if index in batch.present()[0] or index in batch.present()[1]:
        return
    request, began = batch.requests[index], time.monotonic()
    try:
        with contextlib.closing(WorkerSlot(packed_model(_fitting(load(), batch)))) as slot:
            record = slot.run(request, batch.timeout, wanted=lambda: not walltime_over.is_set())
    except InvalidInput as error:
        batch.put(index, ended(request, "killed", UNUSABLE, str(error)))
        return
    if record is None or walltime_over.is_set():
        record = _out_of_walltime(record, request, time.monotonic() - began)
    batch.put(index, record)


def _fitting(model: ForwardModel, batch: ArrayBatch) -> ForwardModel:
    """Return the model as the batch needs it; refuse one that has changed since."""
    if batch.sensitivities and not asks_sensitivities(model):
        model = with_sensitivities(model)
    what, now = "the model has changed since the runs were submitted", fingerprint(model)
    require(now == batch.fingerprint, what, now, batch.fingerprint, "Cancel the array, or undo the change.")
    return model


def _out_of_walltime(record: RunRecord | None, request: RunRequest, seconds: float) -> RunRecord:
    """Return the record of a run that was stopped shortly before SLURM would have stopped it."""
    if record is not None and record.state != "timeout":
        return record
    killed = ended(request, "timeout", "walltime", "still running at the end of its job's walltime, and killed")
    return with_log(replace(killed, seconds=seconds), "" if record is None else record.log)
