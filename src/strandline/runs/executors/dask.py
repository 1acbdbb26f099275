"""Runs on a Dask cluster: on this machine, in jobs of SLURM or PBS, or wherever a scheduler has its workers.

Each run is submitted to one chosen thread of one worker when that thread is free, never earlier, so that a worker that
vanishes takes down exactly the runs that it was making: Dask itself would also condemn what waited behind them, or
repeat for ever what outlives the walltime of its job.
"""

import contextlib
import math
import time
import uuid
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from operator import length_hint
from queue import Empty, SimpleQueue
from typing import Any

from strandline.errors import InvalidInput
from strandline.models.protocol import ForwardModel
from strandline.runs.executors.dask_cluster import JOB_OPTIONS, Cluster, imported, opened
from strandline.runs.executors.dask_job import DaskJob, end_session
from strandline.runs.executors.local import usable_cores
from strandline.runs.executors.options import (
    SPARE_SECONDS,
    require_count,
    require_room_in_walltime,
    require_timeout,
    walltime_seconds,
)
from strandline.runs.executors.packing import packed_model, require_posix
from strandline.runs.record import RunRecord, RunRequest

__all__ = ["DaskCluster"]

KINDS = ("local", "slurm", "pbs")
SECONDS_BETWEEN_DISMISSALS = 2.0
SECONDS_BETWEEN_LOOKS = 1.0
SILENCE_BORNE_SECONDS = 60.0
"""How long the scheduler may be out of reach."""
FETCH_SECONDS = 30.0


@dataclass(frozen=True)
class DaskCluster:
    """Runs on a Dask cluster, each in a worker process of its own beside the Dask worker that was given it.

    Args:
        cluster: ``local``, worker processes on this machine; ``slurm`` or ``pbs``, one worker per job.
        address: of a scheduler that is there already, ``tcp://host:port``; instead of a cluster.
        workers: how many workers, or jobs; the same as `minimum` and `maximum`.
        minimum: jobs that are kept while there are fewer runs left than jobs.
        maximum: jobs at most. A job that vanishes is replaced.
        timeout: seconds after which a run is killed; None for never.
        jobs: of ``slurm`` and ``pbs``: `cores` (runs at a time in a job), `memory`, `walltime`, `queue`, `account`,
            `interface`, and lists `extra` (directives of the job) and `prologue` (lines before the worker starts).

    Raises:
        InvalidInput: options that do not fit together; a timeout that the walltime does not leave room for.
    """

    cluster: str | None = None
    address: str | None = None
    workers: int | None = None
    minimum: int | None = None
    maximum: int | None = None
    timeout: float | None = None
    jobs: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require_timeout(self.timeout)
        for name, least in {"workers": 1, "minimum": 0, "maximum": 1}.items():
            require_count(f"{name} of a Dask cluster", getattr(self, name), remedy="Correct the number.", least=least)
        _require_one_place(self)
        _require_plain_counts(self)
        _require_jobs(self)

    @property
    def kind(self) -> str:
        """What sort of cluster it is: one of `KINDS`, or ``address``."""
        return "address" if self.address is not None else self.cluster or "local"

    def __call__(self, model: ForwardModel, requests: Iterable[RunRequest]) -> Iterator[RunRecord]:
        """Yield a record for each request as runs end.

        Raises:
            InvalidInput: the model cannot be sent to, or loaded by, the workers; the cluster cannot be started or
                reached; the extra ``dask`` is not installed.
        """
        require_posix()
        imported("distributed")
        return self._run(packed_model(model), requests)

    def _run(self, setup: bytes, requests: Iterable[RunRequest]) -> Iterator[RunRecord]:
        most = self.maximum or self.workers or (usable_cores() if self.kind == "local" else 1)
        slots = int(self.jobs.get("cores", 1))
        needed = min(most, -(-length_hint(requests, most * slots) // slots))
        if needed == 0:
            return
        least = min(needed, most if self.minimum is None else self.minimum)
        with opened(self.kind, self.address, needed, self.jobs) as cluster:
            life = walltime_seconds(self.jobs["walltime"]) if "walltime" in self.jobs else None
            driver = _Driver(cluster, setup, iter(requests), self.timeout, life, least)
            try:
                yield from driver.records()
            finally:
                driver.close()


@dataclass
class _Out:
    """A run that a worker was given."""

    request: RunRequest
    worker: str
    future: Any
    began: float


class _Driver:
    """One call: the runs that are out, the records not handed over yet, and the workers that are there."""

    def __init__(
        self,
        cluster: Cluster,
        setup: bytes,
        requests: Iterator[RunRequest],
        timeout: float | None,
        life: float | None,
        least: int,
    ) -> None:
        self.cluster, self.setup, self.requests = cluster, setup, requests
        self.timeout, self.life, self.least = timeout, life, least
        self.session, self.number, self.exhausted = uuid.uuid4().hex, 0, False
        self.out: dict[str, _Out] = {}
        self.news: SimpleQueue[str] = SimpleQueue()
        self.done: deque[tuple[str, RunRecord]] = deque()
        self.threads: dict[str, int] = {}
        self.first_seen: dict[str, float] = {}
        self.retired: dict[str, float] = {}
        self.looked = self.reached = time.monotonic()

    def records(self) -> Iterator[RunRecord]:
        """Yield records until every request that was pulled is answered."""
        self._look()
        while True:
            while self.done:
                _, record = self.done.popleft()
                self._fill()
                yield record
            self._fill()
            if self.exhausted and not self.out and not self.done:
                return
            self._hear()

    def close(self) -> None:
        """Have the runs stopped that are still out."""
        if self.looked > self.reached:
            return  # the scheduler is gone, or was a moment ago
        client: Any = self.cluster.client
        with contextlib.suppress(Exception):  # the scheduler may be gone, and the runs with it
            client.cancel([out.future for out in self.out.values()], force=True)
            client.run(end_session, self.session, on_error="ignore")

    def _fill(self) -> None:
        """Pull a request for each free thread, which starts it there."""
        taken = Counter(out.worker for out in self.out.values()) + Counter(worker for worker, _ in self.done)
        for worker, threads in self.threads.items():
            if self._spent(worker):
                if not taken[worker]:
                    self._retire(worker)
                continue
            for _ in range(threads - taken[worker]):
                request = None if self.exhausted else next(self.requests, None)
                if request is None:
                    self._no_more()
                    return
                self._submit(request, worker)

    def _submit(self, request: RunRequest, worker: str) -> None:
        self.number += 1
        key = f"strandline-{self.session}-{self.number}"
        job = DaskJob(self.session, self.setup, request, self.timeout)
        future = self.cluster.client.submit(
            job, key=key, workers=[worker], allow_other_workers=False, pure=False, retries=0
        )
        self.out[key] = _Out(request, worker, future, time.monotonic())
        future.add_done_callback(lambda done: self.news.put(done.key))

    def _hear(self) -> None:
        """Wait for runs that have ended; look after the workers now and then."""
        with contextlib.suppress(Empty):
            key = self.news.get(timeout=0.1 if not self.threads else SECONDS_BETWEEN_LOOKS)
            self._take(key)
        while not self.news.empty():
            self._take(self.news.get())
        if time.monotonic() >= self.looked + SECONDS_BETWEEN_LOOKS or not self.threads:
            self._look()

    def _take(self, key: str) -> None:
        """Keep the record of a run that has ended."""
        out = self.out.pop(key, None)
        if out is None:
            return
        self.done.append((out.worker, self._record(out)))

    def _record(self, out: _Out) -> RunRecord:
        from distributed import KilledWorker
        from distributed.client import FutureCancelledError

        try:
            record = out.future.result(timeout=FETCH_SECONDS)
        except InvalidInput:
            raise
        except (KilledWorker, FutureCancelledError, TimeoutError, OSError) as error:
            self._look()  # where the scheduler is gone, nothing must be given to it
            return _vanished(out, f"{type(error).__name__}")
        except Exception as error:
            raise _unusable(error) from error
        finally:
            out.future.release()
        if not isinstance(record, RunRecord):
            return _vanished(out, "it was cancelled")
        return replace(record, key=out.request.key, inputs=out.request.inputs)

    def _look(self) -> None:
        """Learn which workers are there; what was out at one that is not is lost."""
        self.looked = time.monotonic()
        try:
            self.threads = dict(self.cluster.client.nthreads())
        except (OSError, TimeoutError, RuntimeError) as error:
            self.threads = {}
            if time.monotonic() > self.reached + SILENCE_BORNE_SECONDS:
                raise _out_of_reach(self.cluster.address, error) from error
            return
        self.reached = self.looked
        for worker in self.threads:
            self.first_seen.setdefault(worker, self.looked)
        if self.cluster.refused is not None and not self.threads:
            raise _refused(self.cluster.refused)
        lost = [key for key, out in self.out.items() if out.worker not in self.threads]
        for key in lost:
            if self.out[key].future.status == "finished":
                continue
            out = self.out.pop(key)
            out.future.cancel(force=True)
            self.done.append((out.worker, _vanished(out, f"the Dask worker {out.worker} is gone")))

    def _spent(self, worker: str) -> bool:
        """Tell whether a run started there now might not end before its job does."""
        if self.life is None or self.timeout is None:
            return False
        return time.monotonic() > self.first_seen[worker] + self.life - self.timeout - 0.5 * SPARE_SECONDS

    def _retire(self, worker: str) -> None:
        """Let a worker go whose job has too little time left; another job takes its place.

        Dask keeps a worker that holds the only copy of a result, as it may of a run that has just ended, and tells
        nobody: as long as the worker is there, it is told again.
        """
        now = time.monotonic()
        if now < self.retired.get(worker, -math.inf) + SECONDS_BETWEEN_DISMISSALS:
            return
        self.retired[worker] = now
        with contextlib.suppress(OSError, TimeoutError):
            self.cluster.client.retire_workers([worker], close_workers=True)

    def _no_more(self) -> None:
        """Let jobs go for which there is nothing left to do."""
        self.exhausted = True
        self.cluster.shrink(max(self.least, len({out.worker for out in self.out.values()})))


def _vanished(out: _Out, how: str) -> RunRecord:
    return RunRecord(
        out.request.key,
        out.request.inputs,
        "killed",
        seconds=time.monotonic() - out.began,
        failure_kind="worker_died",
        message=f"the Dask worker of this run vanished: {how}",
    )


def _require_one_place(options: DaskCluster) -> None:
    if options.cluster is not None and options.cluster not in KINDS:
        raise InvalidInput(
            "cluster of the executor dask",
            value=options.cluster,
            expected=f"one of {', '.join(KINDS)}",
            remedy="Choose one, or give the address of a scheduler.",
        )
    if options.address is not None and options.cluster is not None:
        raise InvalidInput(
            "executor dask: cluster and address",
            value=f"{options.cluster} and {options.address}",
            expected="one of the two",
            remedy="Leave the cluster out where there is a scheduler already.",
        )


def _require_plain_counts(options: DaskCluster) -> None:
    """Refuse numbers that contradict each other, or that somebody else decides."""
    bounds = [value for value in (options.minimum, options.maximum) if value is not None]
    if options.workers is not None and bounds:
        raise InvalidInput(
            "executor dask: workers beside minimum or maximum",
            value=options.workers,
            expected="workers alone, or minimum and maximum",
            remedy="Leave workers out.",
        )
    if options.kind in ("local", "address") and bounds:
        raise InvalidInput(
            "executor dask: minimum and maximum",
            value=bounds,
            expected="cluster: slurm or pbs, whose jobs come and go",
            remedy="Give workers instead.",
        )
    if options.kind == "address" and options.workers is not None:
        raise InvalidInput(
            "executor dask: workers beside the address of a scheduler",
            value=options.workers,
            expected="the workers that the scheduler has",
            remedy="Leave workers out.",
        )
    if options.minimum is not None and (options.maximum is None or options.minimum > options.maximum):
        raise InvalidInput(
            "executor dask: minimum",
            value=options.minimum,
            expected="a maximum that is at least as large",
            remedy="Give one.",
        )


def _require_jobs(options: DaskCluster) -> None:
    if options.kind not in ("slurm", "pbs"):
        if options.jobs:
            raise InvalidInput(
                "executor dask: jobs",
                value=dict(options.jobs),
                expected="none, for this cluster has no jobs",
                remedy="Choose cluster: slurm or pbs, or remove jobs.",
            )
        return
    for name in options.jobs:
        if name not in JOB_OPTIONS:
            raise InvalidInput(
                "executor dask: jobs: unknown option",
                value=name,
                expected=f"one of {', '.join(JOB_OPTIONS)}",
                remedy=f"Remove {name}; directives of the queueing system go under extra.",
            )
    for name in ("cores", "memory", "walltime"):
        if name not in options.jobs:
            raise InvalidInput(
                f"executor dask: jobs.{name}",
                value=None,
                expected="cores, memory and walltime of a job",
                remedy=f"Add {name}.",
            )
    require_count("executor dask: jobs.cores", options.jobs["cores"], remedy="Correct the number.")
    walltime_seconds(options.jobs["walltime"])
    require_room_in_walltime(options.timeout, options.jobs["walltime"])


def _unusable(error: Exception) -> InvalidInput:
    return InvalidInput(
        "runs cannot be made on the Dask workers",
        value=f"{type(error).__name__}: {error}",
        expected="the same strandline, and the model, where the scheduler and its workers are",
        remedy="Install both there, in the same versions as here.",
    )


def _refused(reason: str) -> InvalidInput:
    lines = [line for line in reason.splitlines() if "error" in line.lower()]
    return InvalidInput(
        "the queueing system takes no job for a Dask worker",
        value=lines[-1] if lines else reason,
        expected="jobs with these cores, memory, walltime, queue and account",
        remedy="Correct executor.dask.jobs, and run again: finished runs are kept.",
    )


def _out_of_reach(address: str, error: Exception) -> InvalidInput:
    return InvalidInput(
        f"the Dask scheduler at {address} cannot be reached any more",
        value=f"{type(error).__name__}: {error}",
        expected="an answer within a minute",
        remedy="Start it again and repeat the command: finished runs are kept.",
    )
