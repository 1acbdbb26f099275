"""The driver of one call of the Dask executor: it gives each run to a free thread, and looks after the workers."""

import contextlib
import math
import threading
import time
import uuid
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from queue import Empty, SimpleQueue
from typing import Any

from strandline.foundations import InvalidInput, unfit
from strandline.runs.executors.shared import SPARE_SECONDS, Dispatcher
from strandline.runs.ledger.record import RunRecord, RunRequest, ended
from strandline.runs.worker import WorkerSlot

SECONDS_BETWEEN_DISMISSALS = 2.0
SECONDS_BETWEEN_LOOKS = 1.0
SECONDS_BETWEEN_QUESTIONS = 0.25
"""How long the driver waits for news before it asks again for requests, if there were none the last time."""
SILENCE_BORNE_SECONDS = 60.0
"""How long the scheduler may be unreachable."""
FETCH_SECONDS = 30.0
SESSIONS_REMEMBERED = 1000


@dataclass(frozen=True)
class DaskJob:
    """A task as Dask sees it, which a Dask worker hands to a worker process of strandline: a crash harms only that.

    The session is the call of the executor that it belongs to, `setup` the model, from `packed_model`. Without a
    request it starts a worker process and keeps it for a run. A run is killed after `timeout` seconds.
    """

    session: str
    setup: bytes
    request: RunRequest | None = None
    timeout: float | None = None

    def __call__(self) -> RunRecord | bool | None:
        """Return the run's record, or whether a process loaded the model (else InvalidInput); None if not wanted."""
        wanted = _wanted()
        if self.request is None:
            with _lock:  # the drivers of other sessions may be gone; if not, they start new processes
                others = [session for session in _idle if session != self.session]
            _close_idle(others)
            with _kept(self.session, WorkerSlot(self.setup)) as slot:
                return slot.start(wanted=wanted)
        with _lock:
            mine = _idle.get(self.session)
            idle = mine.pop() if mine else None
        with _kept(self.session, idle or WorkerSlot(self.setup)) as slot:
            return slot.run(self.request, self.timeout, wanted=wanted)


_lock = threading.Lock()
_idle: dict[str, list[WorkerSlot]] = {}
"""The idle slots of this Dask worker, by the session for which they are set up."""
_ended: deque[str] = deque(maxlen=SESSIONS_REMEMBERED)


def end_session(session: str) -> None:
    """End the worker processes of `session` on this Dask worker: the idle ones now, the others after their run."""
    _ended.append(session)
    _close_idle([session])


def _close_idle(sessions: Collection[str]) -> None:
    with _lock:
        slots = [slot for session in sessions for slot in _idle.pop(session, [])]
    for slot in slots:
        slot.close()


@contextlib.contextmanager
def _kept(session: str, slot: WorkerSlot) -> Iterator[WorkerSlot]:
    """Yield `slot`, which is idle afterwards; close it if the session has ended, or after an error."""
    try:
        yield slot
    except BaseException:
        slot.close()
        raise
    with _lock:
        _idle.setdefault(session, []).append(slot)
    if session in _ended:
        _close_idle([session])


def _wanted() -> Callable[[], bool]:
    """Return a function that says whether the scheduler still wants the task of the calling thread."""
    from distributed import get_worker

    worker = get_worker()
    key = worker.get_current_task()

    def wanted() -> bool:
        task = worker.state.tasks.get(key)
        return task is not None and task.state != "cancelled"

    return wanted


@dataclass
class _DaskTask:
    """What was given to a worker: a run, or the start of a worker process if there is no request."""

    request: RunRequest | None
    worker: str
    future: Any
    began: float


@dataclass
class Cluster:
    """A cluster ready for use: our client and, if we started the cluster, what makes its workers."""

    client: Any
    address: str
    maker: Any = None
    submissions: "Submissions | None" = None

    def shrink(self, jobs: int) -> None:
        """Keep only this many jobs; busy ones go last."""
        if self.submissions is not None:
            self.maker.adapt(minimum_jobs=jobs, maximum_jobs=max(jobs, 1))

    def replace_the_lost(self) -> None:
        """Restart workers on this machine that Dask has given up on, as it does if they come back too late."""
        if self.maker is None or self.submissions is not None:
            return
        wanted = self.maker.worker_spec
        if set(wanted) - set(self.maker.workers):
            self.maker.scale(len(wanted))

    @property
    def refused(self) -> str | None:
        """Why the queueing system refused the last job; None if it took the job, or was not asked."""
        return None if self.submissions is None else self.submissions.refused


@dataclass
class Submissions:
    """How the queueing system answered our jobs; Dask would wait forever for a worker whose job was refused."""

    refused: str | None = None

    def noted(self, job_type: Any) -> Any:
        """Return a type of job that reports here."""
        from distributed.core import Status

        submissions = self

        class NotedJob(job_type):  # type: ignore[misc]
            async def start(self) -> None:
                """Submit the job; if the queueing system refuses it, note why."""
                try:
                    await super().start()
                except RuntimeError as error:
                    submissions.refused = str(error)
                    self.status = Status.failed  # else the cluster could not be closed
                    raise
                submissions.refused = None

        return NotedJob


class DaskDispatcher(Dispatcher[str]):
    """One call: the runs that are out, the records not handed over yet, and the workers present.

    A thread gets runs only when it has a worker process that has loaded the model, so no run waits for that. A run is
    killed after `timeout` seconds, a worker lives `life` seconds; None: no limit. At least so many jobs are kept when
    fewer runs than jobs are left, at most so many threads are used; the scheduler may be silent for
    `silence_borne_seconds`.
    """

    def __init__(
        self,
        cluster: Cluster,
        setup: bytes,
        requests: Iterator[RunRequest],
        *,
        timeout: float | None,
        life: float | None,
        least: int,
        most: int,
        silence_borne_seconds: float = SILENCE_BORNE_SECONDS,
    ) -> None:
        super().__init__(requests)
        self.cluster, self.setup = cluster, setup
        self.timeout, self.life, self.least, self.most = timeout, life, least, most
        self.silence_borne_seconds = silence_borne_seconds
        self.session, self.number = uuid.uuid4().hex, 0
        self.out: dict[str, _DaskTask] = {}
        self.news: SimpleQueue[str] = SimpleQueue()
        self.threads: dict[str, int] = {}
        self.ready: dict[str, int] = {}
        self.first_seen: dict[str, float] = {}
        self.retired: dict[str, float] = {}
        self.looked = self.reached = time.monotonic()

    def close(self) -> None:
        """Cancel the runs under way and end this session's processes, unless the scheduler is gone."""
        if self.looked > self.reached:
            return  # the scheduler is gone, or was a moment ago
        client: Any = self.cluster.client
        with contextlib.suppress(Exception):  # the scheduler may be gone, and the runs with it
            client.cancel([task.future for task in self.out.values()], force=True)
            client.run(end_session, self.session, on_error="ignore")

    def free(self) -> str | None:
        """Return a worker with a free thread; let workers go whose job has too little time left."""
        taken = Counter(task.worker for task in self.out.values() if task.request is not None)
        taken.update(worker for worker, _ in self.done)
        free = None
        for worker, ready in self.ready.items():
            if self._spent(worker):
                if not taken[worker]:
                    self._retire(worker)
            elif free is None and taken[worker] < ready:
                free = worker
        return free

    def submit(self, request: RunRequest | None, place: str) -> None:
        """Give a run to a worker; without a request, let it start a worker process."""
        self.number += 1
        key = f"strandline-{self.session}-{self.number}"
        job = DaskJob(self.session, self.setup, request, self.timeout)
        future = self.cluster.client.submit(job, key=key, workers=[place], pure=False, retries=0)
        self.out[key] = _DaskTask(request, place, future, time.monotonic())
        future.add_done_callback(lambda done: self.news.put(done.key))

    def hear(self, *, wait: bool) -> None:
        """Put the runs that have ended into `done`, and look for workers as long as there are none."""
        longest = SECONDS_BETWEEN_QUESTIONS if self.told_to_wait else SECONDS_BETWEEN_LOOKS
        with contextlib.suppress(Empty):
            self._take(self.news.get(timeout=longest if self.threads else 0.1) if wait else self.news.get_nowait())
            while True:
                self._take(self.news.get_nowait())
        if not self.threads:
            self._look()
        self.changed()

    def busy(self) -> bool:
        return any(task.request is not None for task in self.out.values())

    def changed(self) -> bool:
        """Look after the workers if it is time: one may have gone while the next run was chosen."""
        late = time.monotonic() >= self.looked + SECONDS_BETWEEN_LOOKS
        if late:
            self._look()
        return late

    def no_more(self) -> None:
        """Release jobs that have nothing left to do."""
        busy = {task.worker for task in self.out.values() if task.request is not None}
        self.cluster.shrink(max(self.least, len(busy)))

    def _start_processes(self) -> None:
        """Start worker processes for the threads that have none, up to the maximum number of threads."""
        starting = Counter(task.worker for task in self.out.values() if task.request is None)
        room = self.most - sum(self.ready.values()) - starting.total()
        for worker, threads in self.threads.items():
            for _ in range(min(room, threads - self.ready.setdefault(worker, 0) - starting[worker])):
                room -= 1
                self.submit(None, worker)

    def _take(self, key: str) -> None:
        """Keep the record of a run that has ended, or note that a thread is ready."""
        task = self.out.pop(key, None)
        if task is None:
            return
        result = self._result(task.future)
        if task.request is None:
            if result is True and task.worker in self.ready:
                self.ready[task.worker] += 1
        elif isinstance(result, RunRecord):
            self.done.append((task.worker, replace(result, key=task.request.key, inputs=task.request.inputs)))
        elif isinstance(result, Exception):
            self._look()  # if the scheduler is gone, nothing must be given to it
            self._lose(task, type(result).__name__)
        else:
            self._lose(task, "it was cancelled")

    def _lose(self, task: _DaskTask, how: str) -> None:
        """Keep the record of a run that vanished with its worker."""
        if task.request is not None:
            record = ended(task.request, "killed", "worker_died", f"the Dask worker of this run vanished: {how}")
            self.done.append((task.worker, replace(record, seconds=time.monotonic() - task.began)))

    def _result(self, future: Any) -> Any:
        """Return what a future holds, or the error that its worker is gone; refuse workers that can make no runs."""
        from distributed import KilledWorker
        from distributed.client import FutureCancelledError

        try:
            return future.result(timeout=FETCH_SECONDS)
        except InvalidInput:
            raise
        except (KilledWorker, FutureCancelledError, TimeoutError, OSError) as error:
            return error
        except Exception as error:
            what, found = "runs cannot be made on the Dask workers", f"{type(error).__name__}: {error}"
            expected = "the same strandline, and the model, where the scheduler and its workers are"
            raise unfit(what, found, expected, "Install both there, in the same versions as here.") from error
        finally:
            future.release()

    def _look(self) -> None:
        """Find out which workers are present; the runs of those that are gone are lost."""
        self.looked = time.monotonic()
        try:
            self.threads = dict(self.cluster.client.nthreads())
        except (OSError, TimeoutError, RuntimeError) as error:
            self.threads, self.ready = {}, {}
            if time.monotonic() > self.reached + self.silence_borne_seconds:
                what = f"the Dask scheduler at {self.cluster.address} cannot be reached any more"
                remedy = "Start it again and repeat the command: finished runs are kept."
                raise unfit(what, f"{type(error).__name__}: {error}", "an answer within a minute", remedy) from error
            return
        self.reached = self.looked
        self.cluster.replace_the_lost()
        if self.cluster.refused is not None and not self.threads:
            lines = [line for line in self.cluster.refused.splitlines() if "error" in line.lower()]
            what, found = "the queueing system takes no job for a Dask worker", [self.cluster.refused, *lines][-1]
            expected = "jobs with these cores, memory, walltime, queue and account"
            raise unfit(what, found, expected, "Correct executor.dask.jobs, and run again: finished runs are kept.")
        self._forget_the_gone()
        for worker in self.threads:
            self.first_seen.setdefault(worker, self.looked)
        self._start_processes()

    def _forget_the_gone(self) -> None:
        """Record as lost the runs of workers that are no longer there."""
        self.ready = {worker: ready for worker, ready in self.ready.items() if worker in self.threads}
        for key, task in list(self.out.items()):
            if task.worker not in self.threads and (task.request is None or task.future.status != "finished"):
                del self.out[key]
                task.future.cancel(force=True)
                self._lose(task, f"the Dask worker {task.worker} is gone")

    def _spent(self, worker: str) -> bool:
        """Return whether a run started there now might not end before its job does."""
        if self.life is None or self.timeout is None:
            return False
        return time.monotonic() > self.first_seen[worker] + self.life - self.timeout - 0.5 * SPARE_SECONDS

    def _retire(self, worker: str) -> None:
        """Let a worker go whose job has too little time left; another job takes its place.

        Dask silently keeps a worker that holds the only copy of a result, for example of a run that has just ended. So
        the request is repeated until the worker is gone.
        """
        now = time.monotonic()
        if now < self.retired.get(worker, -math.inf) + SECONDS_BETWEEN_DISMISSALS:
            return
        self.retired[worker] = now
        with contextlib.suppress(OSError, TimeoutError):
            self.cluster.client.retire_workers([worker], close_workers=True)
